"""Park the galvo of a scanner outside this package from another process, after the one that drove it died."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

from napari_elsplus.hardware.outside import import_driver, open_outside
from napari_elsplus.hardware.parking import Takeover
from napari_elsplus.hardware.protocols import Scanner

if TYPE_CHECKING:
    from collections.abc import Iterator

    from napari_elsplus.hardware.daq.output import CardSettings
    from napari_elsplus.hardware.parking import ParkState
    from napari_elsplus.hardware.scan.waveform import GalvoLimits

POLL_S: Final = 0.02
"""Seconds between two looks at the state of parking; chosen: small against the 0.5 s within which a galvo parks."""


@dataclass(frozen=True, slots=True)
class DriverOrder(Takeover):
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

    def states(self) -> Iterator[ParkState]:
        """Open the scanner anew, which parks, and close it.

        Yields
        ------
        ParkState
            The scanner's, until it is parked.
        """
        with open_outside(self.kind, Scanner, self.card, self.limits, **self.options) as scanner:
            while not (state := scanner.park_state).parked:
                yield state
                time.sleep(POLL_S)
            yield state
