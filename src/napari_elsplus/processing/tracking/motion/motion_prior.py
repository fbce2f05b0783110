"""Prior of the motion between two frames, and what a registered warp adds to it.

The velocity performs a random walk: white-noise acceleration of variance q per frame period. Velocities (v, w) of both
frames and the displacement D between them are then jointly Gaussian. Stretch and shear of a warp are differences of the
velocities, so that a displacement predicts them: in a full view the frames constrain them well by themselves, where one
fibre is in view they do not, and a free stretch would let it slide along itself. The tails are those of Student's t.

References
----------
Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation (2001), section 6.2.2.
"""

from __future__ import annotations

from math import isfinite, log, log1p, sqrt
from typing import TYPE_CHECKING, Final, NamedTuple

from napari_elsplus.processing.tracking.motion.rolling_shutter import Displacement, Velocity

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.motion.rolling_shutter import RollingShutter, Warp

_MIN_STRETCH_SIGMA: Final = 1e-9
"""Smallest standard deviation of stretch and shear: that of a global shutter."""
DEGREES_OF_FREEDOM: Final = 4.0
"""Of Student's t-distribution: hands jerk, so the tails are heavy; chosen, 3 to 6 serve as well."""


class MotionPrior(NamedTuple):
    """Joint prior of both velocities and the displacement.

    Parameters
    ----------
    before, after : Velocity
        Expected velocities of the earlier and the later frame, pixels per frame period.
    displacement : Displacement
        Expected displacement.
    covariance : tuple of tuple of float
        3 x 3: covariance of earlier velocity, displacement and later velocity, the same for rows and columns.
    shutter : RollingShutter
        Timing of the rows.
    """

    before: Velocity
    after: Velocity
    displacement: Displacement
    covariance: tuple[tuple[float, float, float], ...]
    shutter: RollingShutter

    @property
    def warp(self) -> Warp:
        """Expected warp."""
        return self.shutter.warp(self.before, self.after, self.displacement)

    @property
    def terms(self) -> tuple[float, float, float]:
        """Information on stretch (and shear) at a given shift, its slope with the shift, and 1 / variance of that."""
        variance, of_shift, both = self._of_differences()
        rows = self.shutter.line_periods_per_frame
        conditional = max(variance - both * both / of_shift, 0.0) ** 0.5 / rows + _MIN_STRETCH_SIGMA
        return conditional**-2, both / of_shift / rows, 1 / of_shift

    @property
    def shift_sigma(self) -> float:
        """Standard deviation of the shift, pixels."""
        return sqrt(self.covariance[1][1])

    @property
    def spread(self) -> tuple[float, float]:
        """Standard deviations of stretch and shear at a given shift."""
        return (self.terms[0] ** -0.5,) * 2

    @classmethod
    def between(
        cls, velocities: tuple[Velocity, Velocity], displacement: Displacement, velocity_sigma: float,
        displacement_sigma: float, shutter: RollingShutter,
    ) -> MotionPrior:  # fmt: skip
        """Return the prior of two frames whose velocities and positions are estimated independently.

        Parameters
        ----------
        velocities : tuple of Velocity
            Of the earlier and the later frame.
        displacement : Displacement
            Expected between them.
        velocity_sigma, displacement_sigma : float
            Standard deviations, pixels per frame period and pixels.
        shutter : RollingShutter
            Timing of the rows.
        """
        of_velocity, of_shift = velocity_sigma**2, displacement_sigma**2
        covariance = (of_velocity, 0.0, 0.0), (0.0, of_shift, 0.0), (0.0, 0.0, of_velocity)
        return cls(*velocities, displacement, covariance, shutter)

    def _of_differences(self) -> tuple[float, float, float]:
        """Variances of the difference of the velocities and of the shift, and their covariance."""
        (vv, vd, vw), (_, dd, dw), (_, _, ww) = self.covariance
        return vv + ww - 2 * vw, dd, dw - vd

    def at(self, b: float, d: float) -> Warp:
        """Return the expected warp at another shift.

        Parameters
        ----------
        b, d : float
            Shift in rows and columns, pixels.
        """
        a, b0, s, d0 = self.warp
        slope = self.terms[1]
        return self.warp._replace(a=a + slope * (b - b0), b=b, s=s + slope * (d - d0), d=d)

    def log_density(self, warp: Warp) -> float:
        """Return the logarithm of the probability density of a warp's shift, up to a constant, nats."""
        variance, expected = self.covariance[1][1], self.warp
        miss = ((warp.b - expected.b) ** 2 + (warp.d - expected.d) ** 2) / variance
        return -log(variance) - 0.5 * (DEGREES_OF_FREEDOM + 2) * log1p(miss / DEGREES_OF_FREEDOM)

    def later_velocity(self, warp: Warp, covariance: NDArray[np.float64]) -> tuple[Velocity, float]:
        """Return the later frame's velocity given a registered warp, and its variance (larger axis).

        Parameters
        ----------
        warp : Warp
            From the earlier to the later frame.
        covariance : numpy.ndarray
            (4, 4) covariance of a, b, s, d.
        """
        aa, bb, ab = self._of_differences()
        (_, _, vw), (_, _, dw), (_, _, ww) = self.covariance
        rows = self.shutter.line_periods_per_frame
        # regression of the later velocity on the difference of the velocities (earlier - later) and on minus the shift
        with_difference, with_shift = vw - ww, -dw
        if not isfinite(rows):
            ab = with_difference = rows = 0.0
        aa += 1e-12
        determinant = aa * bb - ab * ab
        p = (bb * with_difference - ab * with_shift) / determinant
        q = (aa * with_shift - ab * with_difference) / determinant
        # displacement and difference are linear in the later velocity
        own, per_velocity = warp.a - 1 if rows else 0.0, warp.b / self.shutter.line_periods_per_frame
        found, surprise = [], 0.0
        for axis, gained, shift in ((0, warp.a - 1, warp.b), (1, warp.s, warp.d)):
            x = rows * gained - self.before[axis] + self.after[axis] if rows else 0.0
            y = self.displacement[axis] + shift
            velocity = (self.after[axis] + p * x + q * y) / (1 - p * own - q * per_velocity)
            x, y = x + own * velocity, y + per_velocity * velocity
            surprise += (bb * x * x - 2 * ab * x * y + aa * y * y) / determinant
            found.append(velocity)
        scaled = p * rows
        s = covariance.tolist()
        spread = max(scaled**2 * s[k][k] + 2 * scaled * q * s[k][k + 1] + q * q * s[k + 1][k + 1] for k in (0, 2))
        left = max(ww - p * with_difference - q * with_shift, 0.0)
        left *= (DEGREES_OF_FREEDOM + surprise) / (DEGREES_OF_FREEDOM + 4)
        return Velocity(*found), left + spread
