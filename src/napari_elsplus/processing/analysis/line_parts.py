"""Core and halo of a standing laser line: two Gaussians fitted to its profile far to either side.

The halo, cross-talk and leaky modes of the bundle, is several times wider than the line and holds up to two thirds of
the light; it decides what ELS+ keeps of the signal.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.optimize import least_squares

from napari_elsplus.errors import MeasurementError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

GROUPS: Final = 8
"""Groups of columns that are left out in turn for the uncertainty; chosen: each holds several dozen cores."""
_CENTRAL: Final = 0.4
"""Part of the line's half length from which profiles are taken; chosen: the rim is then far above and below them."""
_REACH: Final = 0.78
"""Distance from the line to which profiles are fitted, of its half length; derived: inside of the rim there."""
_HONEYCOMB: Final = 0.1
"""Scatter of a group's profile over its level, from the cores' transmission; chosen, that of a few cores."""
_MIN_HALO_SHARE: Final = 0.02
"""Share of the light below which no halo is stated; chosen: its width is then unknown."""
_MIN_SIGMAS: Final = 3.0
"""Standard deviations of the share, of core and of halo, below which none is stated; chosen: one in 400 by chance."""


@dataclass(frozen=True, slots=True)
class LineParts:
    """Core and halo of a laser line, as the camera sees them.

    Parameters
    ----------
    core_rows, halo_rows : float
        Standard deviations, camera rows.
    halo_share : float
        Share of the light in the halo.
    core_uncertainty_rows, halo_uncertainty_rows, halo_share_uncertainty : float
        One standard deviation of each.
    """

    core_rows: float
    halo_rows: float
    halo_share: float
    core_uncertainty_rows: float
    halo_uncertainty_rows: float
    halo_share_uncertainty: float


def measure_line_parts(
    view: NDArray[np.generic], row: float, slope: float, columns: tuple[int, int], core_rows: float
) -> LineParts:
    """Fit core and halo of a laser line that stands near the middle of the bundle.

    Parameters
    ----------
    view : numpy.ndarray
        (rows, cols) view of the bundle, without its background.
    row : float
        Row of the line in the middle of its columns.
    slope : float
        Rows per column.
    columns : tuple of int
        First lit column and the one after the last.
    core_rows : float
        Estimate of the core's standard deviation, rows.

    Raises
    ------
    MeasurementError
        If the profile is not that of a core on a wider halo.
    """
    u, profiles = _profiles(view, row, slope, columns)
    mean = profiles.mean(axis=1)
    noise = float(np.std(np.diff(profiles, axis=0)[np.abs(u[1:]).mean(axis=1) > 0.8 * np.abs(u).max()])) + 1e-6
    weights = 1 / np.hypot(_HONEYCOMB * np.maximum(mean, 0), noise)

    peak, level = float(mean.max()), float(np.percentile(mean, 5))
    start = np.array([0.7 * (peak - level), np.log(core_rows), 0.3 * (peak - level), np.log(5 * core_rows), 0.0, level])
    best = _fit(start, u, profiles, weights[:, None])
    core, halo, share = _parts(best)
    _must_have_halo(core, halo, share)  # where both are one, no step away from there is determined
    sigma = _jackknife_sigma(best, _without_each(best, u, profiles, weights[:, None]))
    significant = min(share, 1 - share) > _MIN_SIGMAS * sigma[2]
    _must_have_halo(core, halo, share if share > _MIN_HALO_SHARE and significant else 0.0)
    return LineParts(core, halo, share, float(sigma[0]), float(sigma[1]), float(sigma[2]))


def _must_have_halo(core: float, halo: float, share: float) -> None:
    """Raise a MeasurementError unless a halo has a share of the light, and twice the width of the core."""
    if not (share > 0 and halo > 2 * core):
        raise MeasurementError(
            f"the line's profile has no halo that is certain ({halo:.1f} rows beside a core of {core:.1f})",
            "let the line stand near the middle of the bundle",
        )


def _fit(start: Floats, u: Floats, profiles: Floats, weights: Floats) -> Floats:
    """Fit the model to grey levels at distances from the line, both (rows, profiles), by Levenberg-Marquardt."""
    return np.asarray(
        least_squares(
            lambda parameters: ((_model(parameters, u) - profiles) * weights).ravel(),
            start,
            lambda parameters: (_derivatives(parameters, u) * weights).reshape(len(start), -1).T,
            x_scale=np.maximum(np.abs(start), 0.1),
            method="lm",
        ).x
    )


def _without_each(best: Floats, u: Floats, profiles: Floats, weights: Floats) -> Floats:
    """Return the parameters without each group, (GROUPS, parameters), one Gauss-Newton step from those of all.

    Parameters
    ----------
    best : numpy.ndarray
        Parameters fitted to all profiles, shape (parameters,).
    u, profiles : numpy.ndarray
        Distances from the line, and grey levels there, (rows, profiles); each group has two of the profiles.
    weights : numpy.ndarray
        Of the rows, (rows, 1).
    """
    misfit = (_model(best, u) - profiles) * weights
    by_group = (_derivatives(best, u) * weights).reshape(len(best), -1, GROUPS).transpose(2, 0, 1)
    curvature = by_group @ by_group.transpose(0, 2, 1)
    pull = (by_group @ misfit.reshape(-1, GROUPS).T[:, :, None])[..., 0]
    steps = np.linalg.pinv(curvature.sum(axis=0) - curvature) @ (pull.sum(axis=0) - pull)[..., None]
    return np.asarray(best - steps[..., 0], np.float64)


def _jackknife_sigma(best: Floats, without: Floats) -> Floats:
    """Return one standard deviation of core, halo and share, from the parameters without each group."""
    core_peak, log_core, halo_peak, log_halo, _, _ = (without - without.mean(axis=0)).T
    core, halo, share = _parts(best)
    by_share = halo_peak / best[2] + log_halo - core_peak / best[0] - log_core
    left_out = np.stack([core * log_core, halo * log_halo, share * (1 - share) * by_share])
    return np.asarray(np.sqrt((GROUPS - 1) / GROUPS * np.square(left_out).sum(axis=1)), np.float64)


def _profiles(view: NDArray[np.generic], row: float, slope: float, columns: tuple[int, int]) -> tuple[Floats, Floats]:
    """Return distances from the line (rows, groups) and the mean grey levels of groups of columns there."""
    first, stop = columns
    middle, half = (first + stop - 1) / 2, (stop - first) / 2
    edges = np.linspace(middle - _CENTRAL * half, middle + _CENTRAL * half, 2 * GROUPS + 1).astype(int)
    reach = int(_REACH * half)
    top, bottom = max(int(row) - reach, 0), min(int(row) + reach + 1, len(view))
    part = view[top:bottom, edges[0] : edges[-1]].astype(np.float64)
    profiles = np.add.reduceat(part, edges[:-1] - edges[0], axis=1) / np.diff(edges)
    centres = (edges[:-1] + edges[1:] - 1) / 2
    u = np.arange(top, bottom)[:, None] - row - slope * (centres - middle)
    return u, profiles


def _model(parameters: Floats, u: Floats) -> Floats:
    """Return core, halo and level at distances from the line; peaks, logarithms of widths, shift, level."""
    core, log_core, halo, log_halo, shift, level = parameters
    z = np.square(u - shift)
    narrow, wide = np.exp(-0.5 * z * np.exp(-2 * log_core)), np.exp(-0.5 * z * np.exp(-2 * log_halo))
    return np.asarray(core * narrow + halo * wide + level)


def _derivatives(parameters: Floats, u: Floats) -> Floats:
    """Return the derivatives of the model by its parameters, (parameters, ...) as `u`."""
    core, log_core, halo, log_halo, shift, _ = parameters
    from_line = u - shift
    by_core, by_halo = (from_line * np.exp(-2 * each) for each in (log_core, log_halo))
    narrow, wide = (np.exp(-0.5 * from_line * by) for by in (by_core, by_halo))
    steep, flat = core * narrow * by_core, halo * wide * by_halo
    return np.stack([narrow, steep * from_line, wide, flat * from_line, steep + flat, np.ones_like(u)])


def _parts(parameters: Floats) -> tuple[float, float, float]:
    """Return the standard deviations of core and halo, and the halo's share of the light."""
    core_rows, halo_rows = float(np.exp(parameters[1])), float(np.exp(parameters[3]))
    light = parameters[0] * core_rows, parameters[2] * halo_rows
    return core_rows, halo_rows, float(light[1] / (light[0] + light[1]))
