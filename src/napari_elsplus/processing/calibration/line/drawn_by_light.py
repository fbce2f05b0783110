"""Rows by which the lines of a sweep are drawn to brighter ones.

Light that changes along the rows moves a line by its variance times the slope of the light's logarithm: light that
falls towards the bundle's rim, and cores of different transmission. The height of the line's smoothed profile has that
slope at every scale of the light that a line resolves.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from napari_elsplus.processing.calibration.line.sweep_influence import (
    Influence,
    influence_of_lines,
    place_in_sweep,
    polynomial_terms,
    runs_of,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.processing.calibration.line.location import Line

    Floats = NDArray[np.float64]

_REACH: Final = 0.4
"""Standard deviation of the weights of neighbouring lines, of the line's; measured, on 320 random rigs: with 0.25 or
0.4 the galvo's slope is equally true, and the wider, the less the scatter of the laser's light counts."""
_ALONE: Final = 0.1
"""Spread of neighbouring lines, of that of the weights, below which they are too few to give a slope; chosen."""


class Drawn(NamedTuple):
    """Rows by which lines are drawn, and what of the light they do not contain line by line.

    Parameters
    ----------
    rows : numpy.ndarray
        Of each line, (lines,).
    light : Influence
        Of the lines on the coefficients of a parabola through their light.
    per_coefficient : numpy.ndarray
        Change of the map's two parameters by each of these, (2, coefficients).
    """

    rows: Floats
    light: Influence
    per_coefficient: Floats


def drawn_by_light(
    volts: Floats, rows: Floats, lines: list[Line], used: NDArray[np.bool_], cut_volts: Floats, cut: list[Line]
) -> Drawn:
    """Return the rows by which lines are drawn to brighter ones.

    A parabola through the light counts as it is. The slopes of the light between neighbouring lines count by the share
    that the rows confirm: light that scatters in time moves no line.

    Parameters
    ----------
    volts, rows : numpy.ndarray
        Voltage of each line and its row, shape (lines,).
    lines : list of Line
        The lines of the map.
    used : numpy.ndarray
        True where a line is no outlier, shape (lines,).
    cut_volts, cut
        Voltages and lines that the bundle's rim cuts short: they show the light beyond the last lines of the map.
    """
    x = place_in_sweep(volts, volts[used])
    terms = np.asarray(np.polynomial.legendre.legvander(x, polynomial_terms(x[used]).shape[1] - 1), np.float64)
    variance = float(np.mean([line.width_rows**2 for line in lines]))
    per_place = np.polyfit(x[used], rows[used], 1)[0]
    light = _log_light(lines)
    parabola = terms[:, :3]
    coefficients, *_ = np.linalg.lstsq(parabola[used], light[used], rcond=None)
    left_over = np.asarray(light[used] - parabola[used] @ coefficients, np.float64)
    influence = influence_of_lines(parabola[used], left_over, parabola[used], runs_of(volts[used]))
    derivatives = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 3.0]])[:, : parabola.shape[1]]
    by_terms = variance / per_place * derivatives
    slowly = terms[:, :2] @ by_terms @ coefficients
    x_cut = place_in_sweep(cut_volts, volts[used])
    beyond = _log_light(cut) - np.polynomial.legendre.legval(x_cut, coefficients)
    reach = _REACH * np.sqrt(variance) / abs(per_place)
    slopes = _slopes(x, np.concatenate([x[used], x_cut]), np.concatenate([left_over, beyond]), reach)
    fast = variance / per_place * slopes

    def beside_a_curve(values: Floats) -> Floats:
        of_used = terms[used]
        return np.asarray(values[used] - of_used @ np.linalg.lstsq(of_used, values[used], rcond=None)[0], np.float64)

    predicted, seen = beside_a_curve(fast), beside_a_curve(rows - slowly)
    share = float(np.clip(predicted @ seen / max(float(predicted @ predicted), np.finfo(float).tiny), 0.0, 1.0))
    return Drawn(slowly + share * fast, influence, (1 - share) * by_terms)


def _log_light(lines: list[Line]) -> Floats:
    """Return the logarithm of the height of each line, smoothed with its own width, but for a constant."""
    return np.log(np.array([line.amplitude * np.sqrt(line.width_rows) for line in lines], np.float64))


def _slopes(at: Floats, places: Floats, values: Floats, reach: float) -> Floats:
    """Return the slopes of straight lines through the values at neighbouring places, 0 where there is but one."""
    weights = np.exp(-0.5 * np.square((at[:, None] - places) / reach))
    weights /= np.maximum(weights.sum(axis=1, keepdims=True), np.finfo(float).tiny)
    away = places - (weights @ places)[:, None]
    spread = (weights * np.square(away)).sum(axis=1) + np.square(_ALONE * reach)
    return np.asarray((weights * away) @ values / spread, np.float64)
