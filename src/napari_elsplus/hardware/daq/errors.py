"""Errors of the card's driver as `DeviceError`, with a remedy."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING, Final

from napari_elsplus.errors import DeviceError

if TYPE_CHECKING:
    from collections.abc import Iterator

UNDERRUN = (
    "the card ran out of samples",
    "close other programs; if it happens again lower card_samples in the rig's file",
)
OUT_OF_RANGE = (
    "a voltage was outside the card's range",
    "check the calibration, and min_v and max_v in the rig's file",
)
GONE = ("the card does not answer any more", "plug it in again, then open the rig again")

IN_USE: Final = -50103
"""Status code of a resource that another task reserves."""
CODES: Final = {
    IN_USE: (
        "the card is in use by another program",
        "close NI MAX's test panels and other programs that drive it; if there is none, switch the laser off and reset "
        "the card in NI MAX",
    ),
    -200220: ("there is no such card", "see its name with `napari-elsplus doctor` and write it into the rig's file"),
    -200170: ("the card has no such channel", "check output, counter and strobe in the rig's file"),
    -200621: UNDERRUN,
    -200290: UNDERRUN,
    -200018: UNDERRUN,
    -200077: OUT_OF_RANGE,
    -200561: OUT_OF_RANGE,
    -201003: GONE,
    -88710: GONE,
}
"""DAQmx status codes with problem and remedy, after NI's list of errors."""

NO_SUCH_CHANNEL: Final = frozenset({-200170, -200430})
"""Status codes of a channel that the card does not have: unknown name, or no input of that kind."""


@contextmanager
def translate_daq_errors(device: str) -> Iterator[None]:
    """Turn nidaqmx's exceptions into a `DeviceError` with a remedy.

    Parameters
    ----------
    device : str
        Name of the card, for the message.

    Raises
    ------
    DeviceError
        For every error of the driver.
    """
    from nidaqmx.errors import DaqError, DaqNotFoundError, DaqNotSupportedError, Error, RpcError

    try:
        yield
    except DaqError as error:
        first = str(error).strip().splitlines()[0]
        problem, remedy = CODES.get(error.error_code, (first, "look the code up in NI MAX"))
        raise DeviceError(f"card {device}: {problem} ({error.error_code})", remedy) from error
    except (DaqNotFoundError, DaqNotSupportedError) as error:
        raise DeviceError(
            "NI's driver is not installed, so no galvo card can be reached", "install NI-DAQmx from ni.com"
        ) from error
    except RpcError as error:
        raise DeviceError(f"card {device}: {GONE[0]} ({error.rpc_code})", GONE[1]) from error
    except Error as error:
        raise DeviceError(f"card {device}: {error}", "update NI-DAQmx") from error
