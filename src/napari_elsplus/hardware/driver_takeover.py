"""Park the galvo of a scanner outside this package from another process, after the one that drove it died."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, field
from itertools import count
from typing import TYPE_CHECKING, Any, Final

from napari_elsplus.hardware.outside import import_driver, open_outside
from napari_elsplus.hardware.parking import RETRY_LATER_S, ParkStage, ParkState, call_each
from napari_elsplus.hardware.protocols import Scanner

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from napari_elsplus.hardware.daq.output import CardSettings
    from napari_elsplus.hardware.scan.waveform import GalvoLimits

POLL_S: Final = 0.02
"""Seconds between two looks at the state of parking; chosen: small against the 0.5 s within which a galvo parks."""


@dataclass(frozen=True, slots=True)
class DriverOrder:
    """Driver and voltage by which another process parks the galvo: a scanner is parked when its constructor returns.

    Parameters
    ----------
    kind : str
        ``"package.module:Class"``.
    card : CardSettings
        Card, wiring, and where it parks.
    limits : GalvoLimits
        Limits of the galvo.
    options : dict
        Keywords with which the class is called, too.
    search_path : tuple of str
        Folders from which the driver is imported: ``sys.path`` of the process that drives.
    """

    kind: str
    card: CardSettings
    limits: GalvoLimits
    options: dict[str, Any] = field(default_factory=dict)
    search_path: tuple[str, ...] = ()

    def preload(self) -> None:
        """Import the driver, so that parking is fast later.

        Raises
        ------
        InputError
            If it cannot be imported.
        """
        sys.path.extend(folder for folder in self.search_path if folder not in sys.path)
        import_driver(self.kind)

    def take_over(self, report: Callable[[ParkState], None] = lambda _: None) -> ParkState:
        """Open the scanner anew, which parks, and close it; tried until it is parked, without end.

        Parameters
        ----------
        report : callable
            Called with the state whenever its stage changes; one that fails does not stop parking.

        Returns
        -------
        ParkState
            The last state.
        """
        last = ParkState()
        for attempt in count(1):
            for state in self._attempt(attempt):
                if state.stage is not last.stage:
                    call_each((report,), state)
                last = state
            if last.parked:
                break
            time.sleep(RETRY_LATER_S)
        return last

    def _attempt(self, attempt: int) -> Iterator[ParkState]:
        """Open the scanner, and yield its states until it is parked, or what went wrong, whatever the driver raised."""
        try:
            with open_outside(self.kind, Scanner, self.card, self.limits, **self.options) as scanner:
                state: ParkState = scanner.park_state
                while not state.parked:
                    yield state
                    time.sleep(POLL_S)
                    state = scanner.park_state
                yield state
        except Exception as error:  # noqa: BLE001 - nobody else would park
            yield ParkState(ParkStage.NOT_PARKED, str(error), attempt)
