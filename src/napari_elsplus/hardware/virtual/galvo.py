"""The virtual galvo: a damped resonance behind the drive."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from math import pi
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.linalg import expm

from napari_elsplus.processing.compiled import kernel

if TYPE_CHECKING:
    from numpy.typing import NDArray

STEP_S: Final = 4e-6
"""Seconds; one sample of the card at 250 kHz."""
SETTLED_AFTER_S: Final = 3e-3
"""Seconds, thirteen time constants of the galvo, after which its earlier position has no influence."""


@dataclass(frozen=True, slots=True)
class GalvoModel:
    """A second-order galvo, in drive volts.

    Parameters
    ----------
    natural_hz : float
        Resonance.
    damping : float
        Damping ratio; the lag behind a ramp is ``damping / (pi natural_hz)``.

    Examples
    --------
    >>> round(GalvoModel().lag_s * 1e6)
    223
    """

    natural_hz: float = 1000.0
    damping: float = 0.7

    @property
    def lag_s(self) -> float:
        """Lag behind a steady ramp, in seconds."""
        return self.damping / (pi * self.natural_hz)

    def follow(self, drive_v: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the position (volts) at the end of each step of `STEP_S`, for a drive constant in each."""
        return np.asarray(follow_drive(drive_v, _step(self.natural_hz, self.damping)))


@cache
def _step(natural_hz: float, damping: float) -> NDArray[np.float64]:
    """Return the exact step of position and speed for a constant drive: rows of (position, speed, drive)."""
    w = 2 * pi * natural_hz
    system = np.zeros((3, 3))
    system[0, 1] = 1.0
    system[1] = -w * w, -2 * damping * w, w * w
    return np.ascontiguousarray(expm(system * STEP_S)[:2])


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
