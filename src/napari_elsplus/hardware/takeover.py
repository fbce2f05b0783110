"""Park the galvo from another process, after the one that drove it died."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

from napari_elsplus.hardware.daq.errors import translate_daq_errors
from napari_elsplus.hardware.daq.output import CardSettings
from napari_elsplus.hardware.daq.scanner import DaqScanner
from napari_elsplus.hardware.daq.session import open_session
from napari_elsplus.hardware.outside import import_driver, open_outside
from napari_elsplus.hardware.parking import RETRY_LATER_S, ParkStage, ParkState, call_each
from napari_elsplus.hardware.protocols import Scanner
from napari_elsplus.hardware.scan.waveform import GalvoLimits

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

POLL_S: Final = 0.02
"""Seconds between two looks at the state of parking; chosen: small against the 0.5 s within which a galvo parks."""
VIRTUAL_LIFE_S: Final = 5.0
"""Seconds without success after which a virtual card has ended with its program; chosen: longer than it lingers."""


@dataclass(frozen=True, slots=True)
class ParkOrder:
    """Scanner and voltage by which another process parks the galvo: a scanner parks when it is opened.

    Parameters
    ----------
    card : CardSettings
        Card, wiring, and where it parks.
    limits : GalvoLimits
        Limits of the galvo.
    kind : str
        ``nidaqmx``, or ``"package.module:Class"`` of a driver outside this package.
    options : dict
        Keywords with which that class is called, too.
    search_path : tuple of str
        Folders from which the driver is imported: ``sys.path`` of the process that drives.
    virtual : bool
        The card is a virtual one, which may end: parking is given up then.
    """

    card: CardSettings
    limits: GalvoLimits
    kind: str = "nidaqmx"
    options: dict[str, Any] = field(default_factory=dict)
    search_path: tuple[str, ...] = ()
    virtual: bool = False

    @classmethod
    def of(cls, fields: dict[str, Any]) -> ParkOrder:
        """Return the order that was written as JSON with these fields."""
        return cls(**fields | {"card": CardSettings(**fields["card"]), "limits": GalvoLimits(**fields["limits"])})

    def preload(self) -> None:
        """Load all modules that parking needs, and call the card's driver once, so that it is fast later.

        Raises
        ------
        DeviceError
            If the card's driver cannot be reached.
        InputError
            If a driver outside this package cannot be imported.
        """
        sys.path.extend(folder for folder in self.search_path if folder not in sys.path)
        if ":" in self.kind:
            import_driver(self.kind)
            return
        import nidaqmx.stream_readers
        import nidaqmx.stream_writers  # noqa: F401 - for later

        session = open_session(self.card.address)
        with translate_daq_errors(self.card.device):
            _ = session.system().driver_version

    def take_over(self, report: Callable[[ParkState], None] = lambda _: None) -> ParkState:
        """Park, from whoever has the card, without end until that is confirmed; on a virtual card until it has ended.

        Parameters
        ----------
        report : callable
            Called with the state whenever its stage changes; one that fails does not stop parking.

        Returns
        -------
        ParkState
            The last state.
        """
        last, end_s = ParkState(), time.monotonic() + VIRTUAL_LIFE_S
        while not (last.parked or (self.virtual and time.monotonic() > end_s)):
            for state in self._states(end_s):
                if state.stage is not last.stage:
                    call_each((report,), state)
                last = state
        return last

    def _states(self, end_s: float) -> Iterator[ParkState]:
        """Open the scanner, close it once it is parked, and yield its states, or what went wrong."""
        try:
            with self._open() as scanner:
                while not (state := scanner.park_state).parked and not (self.virtual and time.monotonic() > end_s):
                    yield state
                    time.sleep(POLL_S)
                yield state
            if scanner.park_state.stage is ParkStage.NOT_PARKED:  # closing parks once more
                yield scanner.park_state
        except Exception as error:  # noqa: BLE001 - a defect, or no memory: nobody else would park
            yield ParkState(ParkStage.NOT_PARKED, f"{type(error).__name__}: {error}")
            time.sleep(RETRY_LATER_S)

    def _open(self) -> Scanner:
        if ":" in self.kind:
            scanner: Scanner = open_outside(self.kind, Scanner, self.card, self.limits, **self.options)
            return scanner
        return DaqScanner(self.card, self.limits, takes_over=True)
