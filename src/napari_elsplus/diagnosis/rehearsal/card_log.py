"""Log of the virtual card's output: when the galvo was clear of the bundle, by the card's own clock."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from napari_elsplus.closing import ClosedOnExit
from napari_elsplus.errors import DeviceError
from napari_elsplus.hardware.virtual.card.process import RemoteCard
from napari_elsplus.hardware.virtual.galvo import STEP_S, GalvoModel
from napari_elsplus.hardware.virtual.timeline import Program, mean_volts, volts_at
from napari_elsplus.instrument.optics import HALO_UM

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.simulation.model.instrument import Instrument

    Series = NDArray[np.float64]

POLL_S: Final = 0.02
"""Seconds between two reads of the card's log; chosen: the card keeps 64 programs, those of 64 ms of slow motion."""
GRID_S: Final = 1e-4
"""Seconds between the times at which the output is evaluated first; chosen: a fortieth of a frame."""
CLEAR_FOR_S: Final = 0.1
"""Least time clear of the bundle in the end that counts as parked; chosen: ten frames, as each has a flyback."""
CLEARANCE_UM: Final = HALO_UM
"""Distance of the line from the rim at which it counts as clear; of the promises."""


class CardLog(ClosedOnExit):
    """Collects what the card's output did, and keeps the card's process alive meanwhile.

    Parameters
    ----------
    place : dict
        Address of the card's process.
    instrument : Instrument
        Optics, which convert volts to rows.
    """

    def __init__(self, place: dict[str, Any], instrument: Instrument) -> None:
        self.card = RemoteCard(place)
        self._instrument = instrument
        self._programs: dict[float, Program] = {}
        self._lock, self._ended = threading.Lock(), threading.Event()
        self._thread = threading.Thread(target=self._collect, name="card log", daemon=True)
        self._thread.start()

    @property
    def programs(self) -> list[Program]:
        """Everything that the output did since the log was opened, oldest first."""
        self._poll()
        with self._lock:
            return [self._programs[since_s] for since_s in sorted(self._programs)]

    def on_bundle(self, from_s: float, until_s: float) -> bool:
        """Return True if the drive was on the bundle at any time from `from_s` to `until_s`."""
        return bool(self._exposed(volts_at(self.programs, np.arange(from_s, until_s, GRID_S))).any())

    def clear_after_s(self, fault_s: float, until_s: float) -> float | None:
        """Return the seconds from a fault to the galvo clear of the bundle for good.

        Parameters
        ----------
        fault_s : float
            Time of the fault, on the card's clock.
        until_s : float
            End of the observation.

        Returns
        -------
        float or None
            0 if it was clear throughout; None if it was not clear for the last `CLEAR_FOR_S`.
        """
        programs = self.programs
        times = np.arange(fault_s, until_s, GRID_S)
        exposed = np.flatnonzero(self._exposed(volts_at(programs, times)))
        if not len(exposed):
            return 0.0
        last = exposed[-1]
        if times[-1] - times[last] < CLEAR_FOR_S:
            return None
        model = GalvoModel()
        begins = np.arange(times[last] - model.settled_after_s, times[last] + 2 * model.settled_after_s, STEP_S)
        galvo = model.follow(mean_volts(programs, begins, STEP_S))
        off = begins[np.flatnonzero(self._exposed(galvo))[-1]] + STEP_S
        return float(max(0.0, off - fault_s))

    def close(self) -> None:
        """Release the card."""
        self._ended.set()
        self._thread.join()
        self.card.close()

    def _exposed(self, volts: Series) -> NDArray[np.bool_]:
        """Return where a drive puts the line less than `CLEARANCE_UM` from the lit bundle, or on it."""
        optics = self._instrument
        rows = (volts - optics.volts_at_row_zero) / optics.volts_per_row
        reach = optics.diameter_px / 2 + optics.optics.rows(CLEARANCE_UM)
        return np.asarray(np.abs(rows - optics.confocal_centre[0]) < reach)

    def _collect(self) -> None:
        while not self._ended.wait(POLL_S):
            try:
                self._poll()
            except DeviceError:
                return

    def _poll(self) -> None:
        programs = self.card.programs()
        with self._lock:
            self._programs.update({program.since_s: program for program in programs})
