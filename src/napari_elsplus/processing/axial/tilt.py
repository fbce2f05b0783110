"""Tilt of a plate against the probe's face, from the light of the halves of the measured square.

The half that is farther away is dimmer, the more so the steeper LS falls there. A plate tilted about a rim that
touches leaves a gap in the middle: its curves begin beyond contact.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.processing.axial.falling_curve import FallingCurve

    Curve = NDArray[np.float64]

LEVELS: Final = (1.0, 0.85, 0.7, 0.5, 0.35)
"""Of LS, share of that in contact, between which its slope is taken; chosen: below a third an uneven background counts,
and the light that a rim of the bundle lacks."""
MIN_FRAMES: Final = 6
"""Frames between these levels, below which no tilt is stated; derived: three times the number of coefficients."""


class SquareHalves(NamedTuple):
    """Light of the halves of the measured square in each frame of a scan, in LS.

    Parameters
    ----------
    asymmetry : numpy.ndarray
        (T, 2) lower less upper half, and right less left one, over their sum.
    apart_um : float
        Distance of the halves' middles.
    radius_um : float
        Of the bundle.
    """

    asymmetry: Curve
    apart_um: float
    radius_um: float

    def first_after(self, earlier: SquareHalves | None) -> SquareHalves:
        """Return those of `earlier` frames and that of the first of these."""
        first = self.asymmetry[:1]
        return self._replace(asymmetry=first if earlier is None else np.append(earlier.asymmetry, first, axis=0))


class Tilt(NamedTuple):
    """Tilt of the plate.

    Parameters
    ----------
    degrees, uncertainty_deg : float
        Angle between the plate and the probe's face, and its standard deviation.
    gap_um : float
        Distance of the plate in the middle where the rim touches it, of the part of the angle beyond its uncertainty.
    """

    degrees: float
    uncertainty_deg: float
    gap_um: float


def plate_tilt(depths_um: Curve, halves: SquareHalves, ls_fall: FallingCurve) -> Tilt | None:
    """Return the tilt of the plate; None where too few frames show it.

    Parameters
    ----------
    depths_um : numpy.ndarray
        (T,) depth of each frame.
    halves : SquareHalves
        Light of the halves of the measured square.
    ls_fall : FallingCurve
        LS from contact on.
    """
    knots_um = ls_fall.depths_at(LEVELS)
    slopes = np.diff(np.log(LEVELS[: len(knots_um)])) / np.diff(knots_um)
    inside = (depths_um >= knots_um[0]) & (depths_um <= knots_um[-1])
    if len(slopes) < 2 or np.count_nonzero(inside) < MIN_FRAMES:
        return None
    segment = np.clip(np.searchsorted(knots_um, depths_um[inside], side="right") - 1, 0, len(slopes) - 1)
    if len(np.unique(segment)) < 2:
        return None
    terms = np.c_[slopes[segment], np.ones(len(segment))]
    factors, *_ = np.linalg.lstsq(terms, halves.asymmetry[inside], rcond=None)
    left = np.square(halves.asymmetry[inside] - terms @ factors).sum(0) / (len(segment) - 2)
    # Half of the difference in height of the halves times the slope of the logarithm is their asymmetry.
    per_height = 2 / halves.apart_um
    tangent = float(np.hypot(*factors[0])) * per_height
    sigma = float(np.sqrt(left.max() * np.linalg.inv(terms.T @ terms)[0, 0])) * per_height
    beyond = float(np.sqrt(max(tangent**2 - 2 * sigma**2, 0.0)))  # two components of noise
    return Tilt(float(np.rad2deg(np.arctan(tangent))), float(np.rad2deg(sigma)), halves.radius_um * beyond)
