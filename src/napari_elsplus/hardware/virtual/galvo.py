"""The virtual galvo: a damped resonance behind the drive."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from math import pi, sqrt
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.linalg import expm

from napari_elsplus.hardware.virtual.timeline import mean_volts
from napari_elsplus.processing.compiled import kernel

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from napari_elsplus.hardware.virtual.timeline import Program
    from napari_elsplus.simulation.model.imperfections import Imperfections

STEP_S: Final = 4e-6
"""Seconds; one sample of the card at 250 kHz."""
STEADY_AFTER: Final = 10
"""Frames after which the galvo's motion is periodic; chosen: 40 ms at 240 Hz, six times the slowest settling."""
_SETTLED_TIME_CONSTANTS: Final = 13.2
"""Time constants after which the galvo's earlier position has no influence: its share is below 2e-6."""


@dataclass(frozen=True, slots=True)
class GalvoModel:
    """A second-order galvo behind a delay, in drive volts.

    Parameters
    ----------
    natural_hz : float
        Resonance.
    damping : float
        Damping ratio; the lag behind a ramp is ``delay_s + damping / (pi natural_hz)``.
    delay_s : float
        Delay of card, amplifier and trigger, in seconds.

    Examples
    --------
    >>> round(GalvoModel().lag_s * 1e6)
    223
    """

    natural_hz: float = 1000.0
    damping: float = 0.7
    delay_s: float = 0.0

    @property
    def lag_s(self) -> float:
        """Lag behind a steady ramp, in seconds."""
        return self.delay_s + self.damping / (pi * self.natural_hz)

    @property
    def settled_after_s(self) -> float:
        """Seconds after which the galvo's earlier position has no influence."""
        slowest = self.damping - sqrt(max(self.damping**2 - 1, 0.0))
        return self.delay_s + _SETTLED_TIME_CONSTANTS / (2 * pi * self.natural_hz * slowest)

    def position(
        self, programs: Sequence[Program], times_s: NDArray[np.float64], since_s: float
    ) -> NDArray[np.float64]:
        """Return the galvo's position (volts) at increasing times, driven by a card's output.

        Parameters
        ----------
        programs : sequence of Program
            The card's output, oldest first.
        times_s : numpy.ndarray
            Increasing times.
        since_s : float
            Time, at most the first of `times_s`, on the grid of steps.
        """
        before = round(self.settled_after_s / STEP_S)
        steps = before + int((times_s[-1] - since_s) / STEP_S) + 3
        begins = np.asarray(since_s - self.delay_s + STEP_S * (np.arange(steps) - before), np.float64)
        volts = self.follow(mean_volts(_since(programs, begins[0]), begins, STEP_S))
        return np.interp(times_s - self.delay_s, begins + STEP_S, volts)

    def follow(self, drive_v: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the position (volts) at the end of each step of `STEP_S`, for a drive constant in each; no delay."""
        return np.asarray(follow_drive(drive_v, _step(self.natural_hz, self.damping)))


def imperfect_galvo(stated: GalvoModel, imperfections: Imperfections) -> GalvoModel:
    """Return the galvo as it moves, from the one that a rig file states.

    Parameters
    ----------
    stated : GalvoModel
        As the rig file states it.
    imperfections : Imperfections
        Resonance and damping where they differ, and the delay.
    """
    return GalvoModel(
        stated.natural_hz if imperfections.galvo_resonance_hz is None else imperfections.galvo_resonance_hz,
        stated.damping if imperfections.galvo_damping is None else imperfections.galvo_damping,
        stated.delay_s + 1e-6 * imperfections.galvo_delay_us,
    )


@cache
def _step(natural_hz: float, damping: float) -> NDArray[np.float64]:
    """Return the exact step of position and speed for a constant drive: rows of (position, speed, drive)."""
    w = 2 * pi * natural_hz
    system = np.zeros((3, 3))
    system[0, 1] = 1.0
    system[1] = -w * w, -2 * damping * w, w * w
    return np.ascontiguousarray(expm(system * STEP_S)[:2])


def _since(programs: Sequence[Program], time_s: float) -> Sequence[Program]:
    """Leave out the programs that were over by a time."""
    over = sum(program.since_s <= time_s for program in programs[1:])
    return programs[over:]


@kernel
def follow_drive(drive_v: NDArray[np.float64], step: NDArray[np.float64]) -> NDArray[np.float64]:
    """Apply the resonance to a drive, from rest at its first voltage.

    Parameters
    ----------
    drive_v : numpy.ndarray
        Drive in volts, one value per step.
    step : numpy.ndarray
        (2, 3), from `_step`.
    """
    out = np.empty_like(drive_v)
    x, v = drive_v[0], 0.0
    for k in range(len(drive_v)):
        u = drive_v[k]
        x, v = step[0, 0] * x + step[0, 1] * v + step[0, 2] * u, step[1, 0] * x + step[1, 1] * v + step[1, 2] * u
        out[k] = x
    return out
