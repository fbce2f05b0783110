"""Park the galvo from another process, after the one that drove it died."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

from napari_elsplus.hardware.daq.errors import translate_daq_errors
from napari_elsplus.hardware.daq.output import CardSettings, Output
from napari_elsplus.hardware.daq.session import open_session
from napari_elsplus.hardware.parking import Parking, Takeover

if TYPE_CHECKING:
    from collections.abc import Iterator

    from napari_elsplus.hardware.daq.scanner import DaqScanner
    from napari_elsplus.hardware.parking import ParkState
    from napari_elsplus.hardware.scan.waveform import GalvoLimits

VIRTUAL_LIFE_S: Final = 5.0
"""Seconds without success after which a virtual card has ended with its program; chosen: longer than it lingers."""


@dataclass(frozen=True, slots=True)
class CardOrder(Takeover):
    """Card and voltage by which another process parks the galvo.

    Parameters
    ----------
    card : CardSettings
        Card, wiring, and where it parks.
    limits : GalvoLimits
        Range of the output.
    virtual : bool
        The card is a virtual one, which may end: parking is given up then.
    """

    card: CardSettings
    limits: GalvoLimits
    virtual: bool = False

    @classmethod
    def of(cls, scanner: DaqScanner, *, virtual: bool = False) -> CardOrder:
        """Return the order that parks the galvo of a scanner, on a real or a `virtual` card."""
        return cls(replace(scanner.card, park_v=scanner.park_v), scanner.limits, virtual)

    def preload(self) -> None:
        """Load all modules that parking needs, and call the driver once, so that it is fast later.

        Raises
        ------
        DeviceError
            If the driver cannot be reached.
        """
        import nidaqmx.stream_readers
        import nidaqmx.stream_writers  # noqa: F401 - for later

        session = open_session(self.card.address)
        with translate_daq_errors(self.card.device):
            _ = session.system().driver_version

    def states(self) -> Iterator[ParkState]:
        """Take the output over and park: a card goes on regenerating its waveform after its program died.

        Tried until the card confirms, without end; on a virtual card until it has ended.

        Yields
        ------
        ParkState
            After each attempt.
        """
        output = Output(self.card, self.limits)
        parking, begun_s = Parking(output, self.card.park_v), time.monotonic()
        while not (state := parking.attempt()).parked:
            yield state
            if self.virtual and time.monotonic() - begun_s > VIRTUAL_LIFE_S:
                break
            time.sleep(state.retry_s)
        output.release()
        yield state
