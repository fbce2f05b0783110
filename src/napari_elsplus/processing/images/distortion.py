"""Low-order distortion of a view: a polynomial of third degree in the position on the confocal view.

It contains every radial distortion of third order about any centre, and the difference of two of them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

POWERS: Final = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2), (3, 0), (2, 1), (1, 2), (0, 3))
"""Powers of row and column of the ten terms of the polynomial."""


def polynomial_terms(rows: Floats, cols: Floats) -> Floats:
    """Return the ten terms of the polynomial at normalised positions.

    Parameters
    ----------
    rows, cols : numpy.ndarray
        Position about the confocal centre over the bundle's radius, any one shape.

    Returns
    -------
    numpy.ndarray
        (10, ...) in the order of :data:`POWERS`.

    Examples
    --------
    >>> polynomial_terms(np.array(2.0), np.array(3.0)).tolist()
    [1.0, 2.0, 3.0, 4.0, 6.0, 9.0, 8.0, 12.0, 18.0, 27.0]
    """
    return np.stack([rows**down * cols**across for down, across in POWERS])
