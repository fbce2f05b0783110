"""Influence of the lines of a sweep on what is fitted to them, by which its uncertainty is known.

Rows of cores bias the lines of many neighbouring voltages alike, so that these are no independent measurements.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from napari_elsplus.processing.analysis.uncertainty import overlapping_influence, small_sample_factor

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

MIN_SWEEP_V: Final = 1e-6
"""Voltages that differ by less are the same; chosen: far below one step of a card."""
RUNS: Final = 20
"""Clusters of neighbouring voltages; chosen: enough for a variance, each wider than a row of cores."""
_NEIGHBOURS: Final = 4
"""Runs of voltages whose errors are correlated; chosen: rows of cores bias the line over many voltages."""
_FREEDOM: Final = 16
"""Degrees of freedom of a covariance by runs and by lines; measured, twice the squared mean over the variance in 1500
draws of noise: 16 of 60 lines, 24 of 400."""
_MAX_DEGREE: Final = 3
"""Of the polynomial that tells whether the galvo is curved; fewer than six different voltages leave a lower one."""


def _ranks(values: Floats) -> NDArray[np.intp]:
    """Return the place of each voltage in the order of the different ones, from 0."""
    return np.unique(np.round(values / MIN_SWEEP_V), return_inverse=True)[1]


def different_voltages(values: Floats) -> int:
    """Return the number of different voltages, or of places of the sweep, in `values` (lines,)."""
    return int(_ranks(values).max()) + 1


def runs_of(volts: Floats) -> NDArray[np.intp]:
    """Return the run of neighbouring voltages to which each of `volts` (lines,) belongs, from 0 to `RUNS` - 1."""
    rank = _ranks(volts)
    return np.asarray(rank * RUNS // (rank.max() + 1), np.intp)


def place_in_sweep(volts: Floats, sweep: Floats | None = None) -> Floats:
    """Return places in a sweep, from -1 to 1; by default in that of all `volts` (lines,)."""
    swept = volts if sweep is None else sweep
    return np.asarray((volts - (swept.max() + swept.min()) / 2) / (np.ptp(swept) / 2), np.float64)


def polynomial_terms(x: Floats) -> Floats:
    """Return the terms of a cubic at places `x` (lines,) of the sweep, (lines, terms).

    For few voltages it is a lower polynomial, which leaves over what tells scatter.
    """
    degree = int(np.clip(different_voltages(x) - 3, 1, _MAX_DEGREE))
    return np.asarray(np.polynomial.legendre.legvander(x, degree), np.float64)


class Influence(NamedTuple):
    """Influence of lines on fitted parameters.

    Influences of the same lines add up, so that what their errors have in common counts as such.

    Parameters
    ----------
    runs : numpy.ndarray
        Of overlapping runs of lines, (runs, parameters).
    lines : numpy.ndarray
        Of each line, as if their errors were independent, (lines, parameters).
    """

    runs: Floats
    lines: Floats

    def less(self, other: Influence, per_parameter: Floats) -> Influence:
        """Return it less another one.

        Parameters
        ----------
        other : Influence
            Of the same lines on other parameters.
        per_parameter : numpy.ndarray
            Change of these parameters by each of the others, (these, others).
        """
        return Influence(*(mine - its @ per_parameter.T for mine, its in zip(self, other, strict=True)))

    @property
    def covariance(self) -> Floats:
        """Covariance of the parameters, (parameters, parameters), of errors like those of neighbouring lines.

        Few runs may agree by chance, hundreds of single lines do not: both count equally.
        """
        both = self.runs.T @ self.runs + self.lines.T @ self.lines
        return np.asarray(small_sample_factor(_FREEDOM) ** 2 * both / 2, np.float64)


def influence_of_lines(jacobian: Floats, left_over: Floats, removed: Floats, runs: NDArray[np.intp]) -> Influence:
    """Return the influence of lines on a least-squares fit.

    Parameters
    ----------
    jacobian : numpy.ndarray
        Of the fit, shape (lines, parameters).
    left_over : numpy.ndarray
        What a fuller model leaves over, shape (lines,).
    removed : numpy.ndarray
        Terms of that model, shape (lines, terms).
    runs : numpy.ndarray
        Of :func:`runs_of`.
    """
    lost = len(left_over) / (len(left_over) - removed.shape[1])
    scores = jacobian * left_over[:, None]
    return Influence(
        overlapping_influence(jacobian, left_over, runs, RUNS, _NEIGHBOURS, removed),
        np.asarray(np.sqrt(lost) * scores @ np.linalg.inv(jacobian.T @ jacobian), np.float64),
    )
