"""A process with a single task: park the galvo if the process that drives it dies.

``kill -9``, a crash in a driver or the system's memory killer leave no time for clean-up, while the card goes on
sweeping the laser, or leaves it on one line of tissue. The guardian waits on a pipe; when it ends without a
farewell, the process at the other end is dead, and the guardian parks.
"""

from __future__ import annotations

import json
import subprocess
import sys
from contextlib import suppress
from dataclasses import asdict
from typing import IO, TYPE_CHECKING, Any, Final, Self, cast

from napari_elsplus.errors import DeviceError
from napari_elsplus.hardware.parking import ParkOrder, carry_out, rehearse

if TYPE_CHECKING:
    from typing import TextIO

READY: Final = "ready"
FAREWELL: Final = "farewell"
"""Messages of the pipe."""


class Guardian:
    """Watches over this process from another one. A context manager: leaving it dismisses the guardian.

    Parameters
    ----------
    order : ParkOrder
        What to do if this process dies.

    Raises
    ------
    DeviceError
        If the guardian does not start.
    """

    def __init__(self, order: ParkOrder) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", __name__],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,  # Ctrl-C and a closed terminal are for us, not for it
        )
        self._say(json.dumps(asdict(order)))
        if cast("IO[str]", self._process.stdout).readline().strip() != READY:
            self.dismiss()
            raise DeviceError("the galvo's guardian did not start", "see the messages above")

    def revise(self, order: ParkOrder) -> None:
        """Give it another order in place of the one before.

        Raises
        ------
        DeviceError
            If it is no more.
        """
        try:
            self._say(json.dumps(asdict(order)))
        except BrokenPipeError:
            raise DeviceError("the galvo's guardian has ended", "connect to the rig again") from None

    def dismiss(self) -> None:
        """End the guardian; the galvo was parked by the caller."""
        with suppress(BrokenPipeError):  # it is gone already
            self._say(FAREWELL)
        for pipe in (self._process.stdin, self._process.stdout):
            with suppress(BrokenPipeError):
                cast("IO[str]", pipe).close()
        self._process.wait()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *reason: object) -> Any:
        self.dismiss()

    def _say(self, line: str) -> None:
        pipe = cast("IO[str]", self._process.stdin)
        pipe.write(line + "\n")
        pipe.flush()


def guard(orders: TextIO, answers: TextIO) -> None:
    """Read park orders, and carry out the last one if they end without a farewell.

    Parameters
    ----------
    orders : file
        One order as JSON per line.
    answers : file
        Receives `READY`.

    Raises
    ------
    DeviceError
        If the galvo could not be parked.
    """
    order = ParkOrder(**json.loads(orders.readline()))
    rehearse(order)
    answers.write(READY + "\n")
    answers.flush()
    while (line := orders.readline()).endswith("\n"):  # one that was cut off was never given
        if line.strip() == FAREWELL:
            return
        order = ParkOrder(**json.loads(line))
    carry_out(order)


if __name__ == "__main__":
    guard(sys.stdin, sys.stdout)
