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

from math import inf, log
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from napari_elsplus.processing.compiled import compilable
from napari_elsplus.processing.tracking.motion.rolling_shutter import Displacement, Velocity, Warp, warp_between

if TYPE_CHECKING:
    from typing import Any, TypeVar

    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.motion.rolling_shutter import RollingShutter

    Covariance = tuple[tuple[float, float, float], ...]
    Terms = tuple[float, float, float]
    Shift = TypeVar("Shift", float, NDArray[np.floating[Any]])

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
    cautious : tuple of tuple of float
        The same by which velocities are estimated: the earlier velocity may be trusted less.
    line_periods_per_frame : float
        Rows of the grid per frame period; infinite for a global shutter.
    """

    before: Velocity
    after: Velocity
    displacement: Displacement
    covariance: Covariance
    cautious: Covariance
    line_periods_per_frame: float

    @property
    def warp(self) -> Warp:
        """Expected warp."""
        return expected_warp(self)

    @property
    def terms(self) -> Terms:
        """Information on stretch (and shear) at a given shift, its slope with the shift, and 1 / variance of that."""
        return terms_of(self.covariance, self.line_periods_per_frame)

    @property
    def spread(self) -> float:
        """Standard deviation of stretch, and of shear, at a given shift."""
        return float(self.terms[0] ** -0.5)

    @classmethod
    def between(
        cls, velocities: tuple[Velocity, Velocity], displacement: Displacement,
        velocity_sigmas: tuple[float, float], displacement_sigma: float, shutter: RollingShutter,
    ) -> MotionPrior:  # fmt: skip
        """Return the prior of two frames whose velocities and positions are estimated independently.

        Parameters
        ----------
        velocities : tuple of Velocity
            Of the earlier and the later frame.
        displacement : Displacement
            Expected between them.
        velocity_sigmas : tuple of float
            Standard deviations of these, pixels per frame period.
        displacement_sigma : float
            That of the displacement, pixels.
        shutter : RollingShutter
            Timing of the rows.
        """
        of_shift = float(displacement_sigma) ** 2
        before, after = (float(sigma) ** 2 for sigma in velocity_sigmas)
        covariance = (before, 0.0, 0.0), (0.0, of_shift, 0.0), (0.0, 0.0, after)
        return cls(*velocities, displacement, covariance, covariance, shutter.line_periods_per_frame)

    def at(self, b: float, d: float) -> Warp:
        """Return the expected warp at another shift.

        Parameters
        ----------
        b, d : float
            Shift in rows and columns, pixels.
        """
        a, b0, s, d0 = self.warp
        slope = self.terms[1]
        return Warp(a + slope * (b - b0), b, s + slope * (d - d0), d)

    def log_density(self, b: Shift, d: Shift) -> Shift:
        """Return the logarithm of the probability density of a shift, up to a constant, nats.

        Parameters
        ----------
        b, d : float or numpy.ndarray
            Shift in rows and columns, pixels.
        """
        variance, expected = self.covariance[1][1], self.warp
        miss = ((b - expected.b) ** 2 + (d - expected.d) ** 2) / variance
        density: Shift = -log(variance) - 0.5 * (DEGREES_OF_FREEDOM + 2) * np.log1p(miss / DEGREES_OF_FREEDOM)
        return density


@compilable
def expected_warp(prior: MotionPrior) -> Warp:
    """Return the expected warp of a `prior`."""
    return warp_between(prior.before, prior.after, prior.displacement, prior.line_periods_per_frame)


@compilable
def terms_of(covariance: Covariance, line_periods_per_frame: float) -> Terms:
    """Return what the information of a prior consists of: :attr:`MotionPrior.terms`.

    Parameters
    ----------
    covariance : tuple of tuple of float
        Of the prior.
    line_periods_per_frame : float
        In rows of the grid.
    """
    variance, of_shift, both = _of_differences(covariance)
    conditional = max(variance - both * both / of_shift, 0.0) ** 0.5 / line_periods_per_frame + _MIN_STRETCH_SIGMA
    return conditional**-2, both / of_shift / line_periods_per_frame, 1 / of_shift


@compilable
def _of_differences(covariance: Covariance) -> Terms:
    """Return variances of the difference of the velocities and of the shift, and their covariance."""
    variance = covariance[0][0] + covariance[2][2] - 2 * covariance[0][2]
    return variance, covariance[1][1], covariance[1][2] - covariance[0][1]


@compilable
def velocity_given(prior: MotionPrior, warp: Warp) -> tuple[Velocity, float, float, float]:
    """Return the later velocity given an exact warp, its variance, and its change with stretch (or shear) and shift.

    By regression of the later velocity on the difference of the velocities (earlier - later) and on minus the shift.

    Parameters
    ----------
    prior : MotionPrior
        Of the motion between the frames.
    warp : Warp
        From the earlier to the later frame.
    """
    covariance, rows = prior.cautious, prior.line_periods_per_frame
    aa, bb, ab = _of_differences(covariance)
    with_difference, with_shift = covariance[0][2] - covariance[2][2], -covariance[1][2]
    before, after, displacement = prior.before, prior.after, prior.displacement
    stretch, of_row, of_col = warp.a - 1, rows * (warp.a - 1), rows * warp.s
    if rows == inf:  # no stretch: the shift alone
        ab = with_difference = stretch = rows = 0.0
        of_row, of_col = before.row - after.row, before.col - after.col
    aa += 1e-12
    determinant = aa * bb - ab * ab
    p = (bb * with_difference - ab * with_shift) / determinant
    q = (aa * with_shift - ab * with_difference) / determinant
    # displacement and difference are linear in the later velocity
    per_velocity = warp.b / prior.line_periods_per_frame
    own = 1 - p * stretch - q * per_velocity
    x_row, x_col = of_row - before.row + after.row, of_col - before.col + after.col
    y_row, y_col = displacement.row + warp.b, displacement.col + warp.d
    row, col = (after.row + p * x_row + q * y_row) / own, (after.col + p * x_col + q * y_col) / own
    x_row, x_col = x_row + stretch * row, x_col + stretch * col
    y_row, y_col = y_row + per_velocity * row, y_col + per_velocity * col
    xx, xy, yy = x_row**2 + x_col**2, x_row * y_row + x_col * y_col, y_row**2 + y_col**2
    surprise = (bb * xx - 2 * ab * xy + aa * yy) / determinant
    left = max(covariance[2][2] - p * with_difference - q * with_shift, 0.0)
    left *= (DEGREES_OF_FREEDOM + surprise) / (DEGREES_OF_FREEDOM + 4)
    return Velocity(row, col), left, p * rows, q
