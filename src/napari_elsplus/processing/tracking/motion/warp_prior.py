"""What is known of a warp before the frames are looked at: stretch and shear follow from the shift.

Stretch and shear of a warp are its two velocities, and the shift is their mean. Where the velocity of the earlier frame
is known, a shift therefore tells the later one's, and with it stretch and shear. In a full view the frames say all this
by themselves; where one fibre is in view they do not, and a free stretch lets it slide along itself.
"""

from __future__ import annotations

from math import hypot, inf, isfinite, sqrt
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from napari_elsplus.processing.tracking.motion.rolling_shutter import Displacement, Velocity

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.motion.rolling_shutter import RollingShutter, Warp

_LEAST_SPREAD = 1e-9


class WarpPrior(NamedTuple):
    """A warp that is expected, and how far from it others may well be.

    Parameters
    ----------
    expected : Warp
        In pixels of full resolution.
    stiffness : float
        Information on stretch a and shear s about what is expected.
    tie : float
        Information on how stretch and shear follow a shift that misses what is expected; 0 where they do not.
    slopes : tuple of float
        Change of a with b, and of s with d, as the later velocity changes.
    """

    expected: Warp
    stiffness: float
    tie: float = 0.0
    slopes: tuple[float, float] = (0.0, 0.0)

    @property
    def terms(self) -> tuple[float, float, float, float]:
        """Stiffness, tie and both slopes, as kernels take them."""
        return self.stiffness, self.tie, *self.slopes

    def at(self, b: float, d: float) -> tuple[float, float, float, float]:
        """Warp of another shift, whose stretch and shear follow.

        Parameters
        ----------
        b, d : float
            Shift in rows and columns, pixels.
        """
        a, b0, s, d0 = self.expected
        follows = self.tie / (self.tie + self.stiffness)
        return a + follows * self.slopes[0] * (b - b0), b, s + follows * self.slopes[1] * (d - d0), d

    def misfit(self, warp: Warp) -> float:
        """How far stretch and shear are from what is expected of them at this shift, in standard deviations.

        Parameters
        ----------
        warp : Warp
            Registered warp.
        """
        a, _, s, _ = self.at(warp.b, warp.d)
        return sqrt(self.stiffness + self.tie) * hypot(warp.a - a, warp.s - s)


def warp_prior(
    shutter: RollingShutter,
    velocities: tuple[Velocity, Velocity],
    displacement: Displacement,
    spread_px: float,
    trust_px: float | None = None,
) -> WarpPrior:
    """Return the prior of a warp between frames of such velocities.

    Parameters
    ----------
    shutter : RollingShutter
        Timing of the rows.
    velocities : tuple of Velocity
        Of the earlier frame, and what is expected of the later one.
    displacement : Displacement
        What is expected between them.
    spread_px : float
        How far the later velocity may well be from that, pixels per frame.
    trust_px : float, optional
        How well the velocity before the later frame's is known. Stretch and shear do not follow the shift where it is
        not, or where the frame before was not linked.

    Examples
    --------
    >>> from napari_elsplus.processing.tracking.motion.rolling_shutter import RollingShutter
    >>> shutter, v = RollingShutter(300.0), Velocity(10.0, 0.0)
    >>> prior = warp_prior(shutter, (v, v), shutter.step(v, v), 2.0, 0.01)
    >>> faster = Velocity(14.0, 0.0)
    >>> true = shutter.warp(v, faster, shutter.step(v, faster))
    >>> round(true.a, 4), round(prior.at(true.b, true.d)[0], 4)
    (0.9873, 0.9873)
    """
    before, after = velocities
    expected = shutter.warp(before, after, displacement)
    rows = shutter.line_periods_per_frame
    stiffness = (spread_px / rows + _LEAST_SPREAD) ** -2
    if trust_px is None or not (isfinite(rows) and isfinite(trust_px)):
        return WarpPrior(expected, stiffness)
    faster = Velocity(after.row + 1, after.col + 1)
    gone = Displacement(displacement.row + 0.5, displacement.col + 0.5)
    other = shutter.warp(before, faster, gone)
    slopes = (other.a - expected.a) / (other.b - expected.b), (other.s - expected.s) / (other.d - expected.d)
    return WarpPrior(expected, stiffness, (2 * trust_px / rows) ** -2, slopes)


def velocity_sigma(information: NDArray[np.float64], shutter: RollingShutter) -> float:
    """How well the warp from the frame before tells a frame's velocity: one standard deviation, pixels per frame.

    Parameters
    ----------
    information : numpy.ndarray
        (4, 4) inverse covariance of a, b, s, d.
    shutter : RollingShutter
        Timing of the rows.
    """
    if not isfinite(shutter.line_periods_per_frame):  # all rows at once: nothing is warped
        return inf
    try:
        covariance = np.linalg.inv(information)
    except np.linalg.LinAlgError:
        return inf
    part = shutter.line_periods_per_frame / 2
    axes = (covariance[k : k + 2, k : k + 2] for k in (0, 2))
    largest = max(part * part * c[0, 0] + 2 * part * c[0, 1] + c[1, 1] for c in axes)
    return float(np.sqrt(largest)) if largest >= 0 else inf
