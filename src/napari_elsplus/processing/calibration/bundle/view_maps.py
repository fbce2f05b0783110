"""Maps from the confocal to the residual view: polynomials of third degree, and the models that the cores choose from.

A map gives row and column about the residual centre, px, as (2, 10) coefficients of the terms of the position about the
confocal centre over the bundle's radius. A model is a linear space of departures from the identity, and contains the
one before it.
"""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.processing.images.distortion import POWERS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]


class ViewModel(StrEnum):
    """Maps from the confocal to the residual view, from the simplest."""

    SHIFT = "shift"
    SIMILARITY = "similarity"
    AFFINE = "affine"
    RADIAL = "radial distortion"
    CUBIC = "cubic distortion"

    @property
    def basis(self) -> Floats:
        """Coefficients of the departures from the identity that span the model, shape (parameters, 2, 10)."""
        return _BASES[self]


UNDISTORTED: Final = (ViewModel.SHIFT, ViewModel.SIMILARITY, ViewModel.AFFINE)
DISTORTED: Final = (ViewModel.AFFINE, ViewModel.RADIAL, ViewModel.CUBIC)
"""Models that are compared with each other; the last of each contains the others."""


def affine_map(motion: Floats, radius_px: float) -> Floats:
    """Return the coefficients (2, 10) of an affine motion (2, 3) about the centres.

    Parameters
    ----------
    motion : numpy.ndarray
        Maps (row, col, 1) about the confocal centre to (row, col) about the residual centre.
    radius_px : float
        Of the bundle in the confocal view.
    """
    coefficients = np.zeros((2, len(POWERS)))
    coefficients[:, 0], coefficients[:, 1:3] = motion[:, 2], radius_px * motion[:, :2]
    return coefficients


def nearest_affine(coefficients: Floats, terms: Floats, radius_px: float) -> Floats:
    """Return the affine motion (2, 3) that is nearest to a map at some points; of an affine map its own.

    Parameters
    ----------
    coefficients : numpy.ndarray
        (2, 10) map.
    terms : numpy.ndarray
        (10, points): the polynomial's terms at the points.
    radius_px : float
        Of the bundle in the confocal view.
    """
    beyond = np.linalg.lstsq(terms[:3].T, (coefficients[:, 3:] @ terms[3:]).T, rcond=None)[0].T
    affine = coefficients[:, :3] + beyond
    return np.column_stack([affine[:, 1:] / radius_px, affine[:, 0]])


def _field(row: dict[tuple[int, int], float], col: dict[tuple[int, int], float]) -> Floats:
    """Return the coefficients (2, 10) of a displacement, by the powers of row and column of its terms."""
    return np.array([[part.get(power, 0.0) for power in POWERS] for part in (row, col)])


_ONE, _ROW, _COL = POWERS[:3]
_SHIFT: Final = [_field({_ONE: 1}, {}), _field({}, {_ONE: 1})]
_SIMILARITY: Final = [*_SHIFT, _field({_ROW: 1}, {_COL: 1}), _field({_COL: -1}, {_ROW: 1})]
_MATRIX: Final = [_field({_ROW: 1}, {}), _field({_COL: 1}, {}), _field({}, {_ROW: 1}), _field({}, {_COL: 1})]
_AFFINE: Final = [*_SHIFT, *_MATRIX]
_RADIAL: Final = [
    *_AFFINE,
    _field({(3, 0): 1, (1, 2): 1}, {(2, 1): 1, (0, 3): 1}),  # r^2 p
    _field({(2, 0): 3, (0, 2): 1}, {(1, 1): 2}),  # its derivative by the row of its centre, and by the column
    _field({(1, 1): 2}, {(0, 2): 3, (2, 0): 1}),
]
_BASES: Final = {
    ViewModel.SHIFT: np.array(_SHIFT),
    ViewModel.SIMILARITY: np.array(_SIMILARITY),
    ViewModel.AFFINE: np.array(_AFFINE),
    ViewModel.RADIAL: np.array(_RADIAL),
    ViewModel.CUBIC: np.eye(2 * len(POWERS)).reshape(-1, 2, len(POWERS)),
}
