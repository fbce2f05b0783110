"""The part of the tissue's displacements that is the same at all times: the shape of a mosaic, no deformation.

Images show how frames are deformed relative to one another; in which shape the tissue rests they do not show, and that
each frame is deformed as little as can be leaves it to chance: a place is in view for a small part of the time, and how
it is strained by then adds up along the path. Tissue moves about its rest, alike at near places soon after one another,
otherwise elsewhere and later. Displacements are therefore taken for the sum of four Gaussian processes (Rasmussen and
Williams, *Gaussian Processes for Machine Learning*, 2006, section 2.2): the tissue's motion, which depends on place and
time; what is alike at all times; a shift of each frame, by which the probe is misplaced; and an error. The second of
them is estimated.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.linalg import cho_factor, cho_solve

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

LENGTH_DIAMETERS: Final = 0.5
MEMORY_FRAMES: Final = 10.0
"""Distance and time over which tissue moves alike: standard deviation of a Gaussian, diameters of a frame, and decay
of an exponential; chosen on ten recordings under strains of 3 %. Twice the length costs all of the gain, 0.35 and 0.7
a third of it; half or twice the time nothing."""
_STATIC: Final = 100.0
_SHIFT: Final = 100.0
_ERROR: Final = 1e-3
"""Variances of what is alike at all times, of the frames' shifts and of errors, over that of the tissue's motion;
chosen: the first two unknown, the last small. A tenth or ten times of each changes little."""


def static_part(at: Floats, frame: NDArray[np.int64], moved: Floats, length: float) -> Callable[[Floats], Floats]:
    """Return a function that returns, at points (m, 2), the part of displacements (m, 2) that is alike at all times.

    Parameters
    ----------
    at : numpy.ndarray
        (n, 2) points of which the displacements are known.
    frame : numpy.ndarray
        (n,) number of the frame that shows each.
    moved : numpy.ndarray
        (n, 2) displacements.
    length : float
        Distance over which tissue moves alike, in the unit of the points.

    Examples
    --------
    Of two points in each of ten frames the second is always displaced by 1 more:

    >>> at = np.tile([[0.0, 0.0], [1.0, 0.0]], (10, 1))
    >>> moved = np.tile([[0.0, 0.0], [0.0, 1.0]], (10, 1))
    >>> still = static_part(at, np.arange(0, 1000, 100).repeat(2), moved, 0.5)(at[:2])
    >>> np.round(still[1] - still[0], 1).tolist()
    [0.0, 1.0]
    """
    apart = np.abs(np.subtract.outer(frame, frame))
    covariance = _alike(at, at, length) * (np.exp(-apart / MEMORY_FRAMES) + _STATIC) + _SHIFT * (apart == 0)
    weights = _STATIC * cho_solve(cho_factor(covariance + _ERROR * np.eye(len(at))), moved)
    return lambda wanted: _alike(wanted, at, length) @ weights


def _alike(here: Floats, there: Floats, length: float) -> Floats:
    """Return how alike tissue moves at points (m, 2) and (n, 2): (m, n), from 0 to 1."""
    square = np.square(here[:, None] - there).sum(axis=-1)
    return np.asarray(np.exp(-square / (2 * length**2)), np.float64)
