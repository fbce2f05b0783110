"""Bow of the laser line: the parabola that its columns' departures from a straight line fit."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

LIGHT: Final = (0.1, 10.0)
"""Of a run of columns over that of the line, as its weight; chosen: beyond it is no line that has a bow."""


class Bow(NamedTuple):
    """Bend of a line, rows per squared column; height in its middle of the straight line through squared columns."""

    bend: float
    mean_square_px: float


def fit_bow(
    left: Floats, model: Floats, slopes: Floats, taper: Floats, x: Floats, run: NDArray[np.intp], runs: int
) -> Bow:
    """Fit a parabola to what a straight line leaves over.

    The model has one amplitude, but each run of columns pulls the straight line by the light of its own: its weight.

    Parameters
    ----------
    left, model, slopes, taper : numpy.ndarray
        Data less the straight line's model, that model without its background, its derivative by the row, and the
        weights, (samples,).
    x, run : numpy.ndarray
        Column of each sample, from the line's middle, and its run of columns, (samples,).
    runs : int
        Number of runs.
    """
    contrast = taper * (model - (taper * model).sum() / max(float(taper.sum()), 1e-12))
    excess = np.bincount(run, contrast * left, runs) / np.maximum(np.bincount(run, contrast * model, runs), 1e-12)
    pull = np.bincount(run, slopes * taper * left, runs)
    weights = np.bincount(run, slopes * taper * slopes, runs) * np.clip(1 + excess, *LIGHT)
    at = np.bincount(run, x, runs) / np.maximum(np.bincount(run, minlength=runs), 1)
    basis = np.stack([np.ones(runs), at, at**2], axis=1)
    moments = basis.T @ (weights[:, None] * basis)
    bend = float(np.linalg.lstsq(moments, basis.T @ pull, rcond=None)[0][2])
    spread = moments[0, 0] * moments[1, 1] - moments[0, 1] ** 2
    height = moments[1, 1] * moments[0, 2] - moments[0, 1] * moments[1, 2]
    return Bow(bend, float(height / spread) if spread > 0 else 0.0)
