"""A scanner driver of one's own, as small as one can be: for a bench whose line does not move.

Implements `napari_elsplus.hardware.protocols.Scanner`. It refuses to hold or scan, so that nothing above it can
take a scan for granted. A module that the rig file ``playback.toml`` imports: running it as a script does nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Self

from napari_elsplus.errors import DeviceError
from napari_elsplus.hardware.daq.output import CardSettings
from napari_elsplus.hardware.parking import ParkStage, ParkState
from napari_elsplus.hardware.scan.waveform import GalvoLimits, Waveform


class StillScanner:
    """A scanner that is always parked.

    Parameters
    ----------
    card : CardSettings
        Table ``card`` of the rig file; only the parking voltage is used.
    limits : GalvoLimits
        Table ``mirror`` of the rig file.
    """

    ramps_begun = 0

    def __init__(self, card: CardSettings, limits: GalvoLimits) -> None:
        limits.check(card.park_v, "the parking position")
        self.park_v, self._limits = card.park_v, limits

    @property
    def park_state(self) -> ParkState:
        """Parked: the line never moves."""
        return ParkState(ParkStage.PARKED)

    def on_park_state(self, callback: Callable[[ParkState], None]) -> Callable[[], None]:
        """Return at once: the state never changes."""
        del callback
        return lambda: None

    def watch_frames(self, received: Callable[[], int] | None) -> None:
        """Do nothing: there is no scan to stop."""

    def park_at(self, volts: float) -> None:
        """Keep the parking voltage, within the limits."""
        self._limits.check(volts, "the parking position")
        self.park_v = volts

    def hold(self, volts: float) -> None:
        """Refuse: there is no galvo."""
        raise DeviceError(f"{volts:g} V for a rig without a galvo", "choose a rig that has one")

    def scan(self, waveform: Waveform) -> None:
        """Refuse: there is no galvo."""
        raise DeviceError(f"a scan of {waveform.ramps} ramp(s) for a rig without a galvo", "choose a rig that has one")

    def check(self) -> None:
        """Do nothing: nothing can go wrong."""

    def park(self) -> None:
        """Do nothing: the line never moved."""

    def close(self) -> None:
        """Do nothing: nothing is open."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *reason: object) -> Any:
        self.close()
