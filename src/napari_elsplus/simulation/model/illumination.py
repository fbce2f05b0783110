"""Vignetting by the rim of the bundle: the laser line is a chord of the bundle, and so is its halo.

Without a rim the signal of a plane separates into rows and columns (:mod:`scan`). The rim enters as a ratio, clipped
over unclipped, of what a uniform plane would give: exact for uniform planes, close for textured ones. The halo arises
inside the bundle (cross-talk, leaky modes), so it too needs the line to stand on the bundle; that is why the residual
image is dark where the slit has entered the bundle and the line has not (Thrapp and Hughes, Sec. 3.3). It is as long as
the chord on which the light entered, as along the line neighbours exchange equal shares, and it leaves where there are
cores.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from scipy.special import erf

from napari_elsplus.processing.compiled import kernel
from napari_elsplus.simulation.model.bells import BELL, ERF, bell, error_function

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.simulation.model.axial_response import LineModel

    Grid = NDArray[np.float64]

GRID_POINTS: Final = 96
"""Grid points across the bundle, even; measured: with 160 no drop-off distance changes by 0.1 um."""
_NODES = np.linspace(-3.2, 3.2, 13)
"""Nodes of the quadrature over a Gaussian, in standard deviations."""
_NODE_WEIGHTS = np.exp(-0.5 * _NODES**2) / np.exp(-0.5 * _NODES**2).sum()
"""Weights of the nodes, of sum 1; derived, the Gaussian at them."""
_ENTRY_STEP: Final = 0.5
"""From one row on which the halo's light enters to the next, in standard deviations of the line's core; derived: a sum
of a Gaussian's values at such steps is its integral to 1e-30, and to some 1e-3 where the rim cuts it off."""
_ENTRY_REACH: Final = 3.5
"""Standard deviations from the line beyond which no light of its core enters; derived: 5e-4 of it lie there."""
_LIT_ENTRIES: Final = round(2 * _ENTRY_REACH / _ENTRY_STEP)
"""Most rows of a line on which its light enters; derived."""
_ENTRY_HEIGHT: Final = float(_ENTRY_STEP / np.sqrt(2 * np.pi) / erf(_ENTRY_REACH / np.sqrt(2)))
"""Share of the line's light that enters on the row in its middle; derived: the shares have the sum 1."""
_NEGLIGIBLE: Final = 1e-15
"""Light per um that leaves on a row, relative to all that enters, below which it is left out; chosen."""
_KEPT_DEPTHS: Final = 12
"""Depths for which the halo is kept, of up to 9 MB each; derived: of three planes and the bundle's own light, with and
without cross-talk on the way back, and some to spare."""


class _Halo(NamedTuple):
    """Halo that is collected from a depth, as far as it was computed.

    ``collect``, (points, points), is the share that a grid cell gives to a grid point, along rows and along columns;
    ``light``, (points, entries, points), the light per um in each grid row and column of what enters on a row, where
    ``known``, (points, entries), is True.
    """

    collect: NDArray[np.float32]
    known: NDArray[np.bool_]
    light: NDArray[np.float32]


@lru_cache(maxsize=4)
def vignetting(radius_um: float, line: LineModel, slit_um: float) -> Vignetting:
    """Return the vignetting of a bundle, cached; parameters as of :class:`Vignetting`."""
    return Vignetting(radius_um, line, slit_um)


class Vignetting:
    """Vignetting of a round bundle, on a coarse grid that covers it.

    Parameters
    ----------
    radius_um : float
        Radius of the bundle.
    line : LineModel
        The laser line.
    slit_um : float
        Slit width, by which the line is smeared during the exposure.
    """

    def __init__(self, radius_um: float, line: LineModel, slit_um: float) -> None:
        points = GRID_POINTS
        self.radius_um = radius_um
        self.grid_um: Grid = np.linspace(-radius_um, radius_um, points)
        self._line = line
        self._core_um, self._halo_um = (float(np.hypot(s, slit_um / np.sqrt(12))) for _, s in line.parts)
        self._inner_um = float(np.sqrt(line.halo_um**2 - line.core_um**2))
        self._height = float(1 / (np.sqrt(2 * np.pi) * self._inner_um))
        step = self.grid_um[1] - self.grid_um[0]
        fine = (np.arange(8) + 0.5) / 8 - 0.5
        rows = (self.grid_um[:, None] + step * fine).ravel()
        inside = rows[:, None] ** 2 + rows[None, :] ** 2 <= radius_um**2
        self._disc = inside.reshape(points, 8, points, 8).mean((1, 3)).astype(np.float32)
        self._step_um = float(step)
        self._cell_edges = np.append(self.grid_um - step / 2, self.grid_um[-1] + step / 2)
        entries = max(int(np.ceil(2 * radius_um / (_ENTRY_STEP * self._core_um))), _LIT_ENTRIES)
        self._entries_um: Grid = np.asarray((np.arange(entries) - (entries - 1) / 2) * _ENTRY_STEP * self._core_um)
        self._halos: dict[float, _Halo] = {}

    def vignette(self, offsets_um: Grid, depth_um: float) -> Grid:
        """Return clipped over unclipped signal of a uniform plane, for core and halo of the line.

        Parameters
        ----------
        offsets_um : numpy.ndarray
            Line minus slit for each grid row, shape (points,).
        depth_um : float
            Depth of the plane.

        Returns
        -------
        numpy.ndarray
            (2, points, points): core and halo; grid rows, grid columns.
        """
        spread_um = self._line.spread * depth_um
        return np.stack([self._core(offsets_um, spread_um), self._halo(offsets_um, spread_um)])

    def _core(self, offsets_um: Grid, spread_um: float) -> Grid:
        points = len(self.grid_um)
        if spread_um == 0:  # a core sees its own light only
            return np.ones((points, points))
        pull = spread_um**2 / (self._core_um**2 + spread_um**2)
        narrow_um = self._core_um * np.sqrt(pull)
        clipped = np.zeros((points, points))
        rows_um = self._around(self.grid_um + pull * offsets_um, narrow_um)
        _clip_core(clipped, rows_um, self.grid_um, _NODE_WEIGHTS, self.radius_um, 1 / (np.sqrt(2) * spread_um), ERF)
        return clipped

    def _halo(self, offsets_um: Grid, spread_um: float) -> Grid:
        unclipped = _gaussian(offsets_um, float(np.hypot(self._halo_um, spread_um)))
        visible = np.flatnonzero(unclipped > 1e-9)
        result = np.ones((len(self.grid_um), len(self.grid_um)))
        clipped = np.zeros((len(visible), len(self.grid_um)))
        line_um = (self.grid_um + offsets_um)[visible]
        if spread_um == 0:
            rows_um = self._around(line_um, self._core_um)
            along_rows = _bells((self.grid_um[visible, None] - rows_um) / self._inner_um, BELL) * self._height
            _sum_chords(clipped, rows_um, along_rows, self.grid_um, _NODE_WEIGHTS, self.radius_um, self._step_um)
        else:
            self._collect_halo(clipped, visible, line_um, self._halo_at(spread_um))
        result[visible] = clipped / unclipped[visible, None]
        return result

    def _collect_halo(self, clipped: Grid, rows: NDArray[np.intp], line_um: Grid, halo: _Halo) -> None:
        """Write the halo that is collected on some rows of the grid while the line is on a row for each of them.

        What enters on a row and is collected on another is computed once. (A product of matrices would be passed to
        threads of the library that computes it, which take longer to meet than it takes on a computer that is busy.)
        """
        entries_um, weights = self._entries_um, np.empty((len(rows), _LIT_ENTRIES), np.float32)
        first = np.empty(len(rows), np.int64)
        _enter(first, weights, line_um, entries_um[0], len(entries_um), self._core_um, BELL)
        _leave(
            halo, rows, first, weights, entries_um, self.grid_um, self._disc, self._height,
            self._inner_um, self.radius_um, self._step_um, BELL,
        )  # fmt: skip
        halo.known[rows[:, None], first[:, None] + np.arange(_LIT_ENTRIES)] |= weights > 0
        _sum_entries(clipped, halo.light, rows, first, weights)

    def _halo_at(self, spread_um: float) -> _Halo:
        """Return what is known of the halo that is collected from a depth; the oldest depth is discarded for it."""
        if spread_um not in self._halos:
            if len(self._halos) >= _KEPT_DEPTHS:
                self._halos.pop(next(iter(self._halos)))
            edges = erf((self._cell_edges[None, :] - self.grid_um[:, None]) / (np.sqrt(2) * spread_um))
            collect = (0.5 * np.diff(edges, axis=1)).astype(np.float32)
            known = np.zeros((len(collect), len(self._entries_um)), bool)
            self._halos[spread_um] = _Halo(collect, known, np.empty((*known.shape, len(collect)), np.float32))
        return self._halos[spread_um]

    def _around(self, rows_um: Grid, sigma_um: float) -> Grid:
        """Return rows at the nodes of a Gaussian around each row, (rows, nodes)."""
        return np.asarray(rows_um[:, None] + sigma_um * _NODES)


def _gaussian(offset_um: Grid, sigma_um: float) -> Grid:
    return np.asarray(np.exp(-0.5 * (offset_um / sigma_um) ** 2) / (np.sqrt(2 * np.pi) * sigma_um))


@kernel
def _bells(u: Grid, table: Grid) -> Grid:
    values = np.empty_like(u)
    for i in range(u.shape[0]):
        for q in range(u.shape[1]):
            values[i, q] = bell(table, u[i, q])
    return values


@kernel
def _clip_core(
    clipped: Grid, rows_um: Grid, grid_um: Grid, weights: Grid, radius_um: float, per_um: float, table: Grid
) -> None:
    """Add the shares of a Gaussian around each column that fall onto the chords at the rows of each row's nodes."""
    points = len(grid_um)
    for i in range(len(rows_um)):
        for q in range(len(weights)):
            if abs(rows_um[i, q]) >= radius_um:
                continue
            half_um = np.sqrt(radius_um**2 - rows_um[i, q] ** 2)
            for j in range(points // 2, points):
                right = error_function(table, (half_um - grid_um[j]) * per_um)
                share = 0.5 * (right + error_function(table, (half_um + grid_um[j]) * per_um))
                clipped[i, j] += weights[q] * share
        for j in range(points // 2):
            clipped[i, j] = clipped[i, points - 1 - j]


@kernel
def _enter(
    first: NDArray[np.int64],
    weights: NDArray[np.float32],
    rows_um: Grid,
    first_um: float,
    entries: int,
    sigma_um: float,
    table: Grid,
) -> None:
    """Write the first of successive entries that a line on each row lights, and their shares of its light."""
    step_um = _ENTRY_STEP * sigma_um
    for n in range(len(rows_um)):
        at = (rows_um[n] - first_um) / step_um
        lowest = np.ceil(at - _ENTRY_REACH / _ENTRY_STEP)
        first[n] = int(min(max(lowest, 0.0), float(entries - _LIT_ENTRIES)))
        for q in range(_LIT_ENTRIES):
            away = (first[n] + q - at) * _ENTRY_STEP
            weights[n, q] = bell(table, away) * _ENTRY_HEIGHT if abs(away) <= _ENTRY_REACH else 0


@kernel
def _leave(
    halo: _Halo,
    rows: NDArray[np.intp],
    first: NDArray[np.int64],
    weights: NDArray[np.float32],
    entries_um: Grid,
    grid_um: Grid,
    disc: NDArray[np.float32],
    height: float,
    inner_um: float,
    radius_um: float,
    step_um: float,
    table: Grid,
) -> None:
    """Write the halo that is collected at each column of some grid rows, of light that enters on some rows; once.

    It leaves on all rows of the grid where there are cores, spread over the columns of the chord on which it entered.
    """
    points, collect = len(grid_um), halo.collect
    leaving = np.empty(points, np.float32)
    for n in range(len(rows)):
        i = rows[n]
        for q in range(_LIT_ENTRIES):
            k = first[n] + q
            if halo.known[i, k] or weights[n, q] == 0:
                continue
            half_um = np.sqrt(max(radius_um**2 - entries_um[k] ** 2, 0.0))
            leaving[:] = 0
            for g in range(points):
                value = np.float32(height * bell(table, (grid_um[g] - entries_um[k]) / inner_um) * collect[i, g])
                if value > _NEGLIGIBLE:
                    for c in range(points):
                        leaving[c] += value * disc[g, c]
            collected = halo.light[i, k]
            collected[:] = 0
            for c in range(points):
                share = min(max((half_um - abs(grid_um[c])) / step_um + 0.5, 0.0), 1.0)
                value = np.float32(share) * leaving[c]
                for j in range(points):
                    collected[j] += value * collect[c, j]  # as much as in the other direction


@kernel
def _sum_entries(
    clipped: Grid,
    light: NDArray[np.float32],
    rows: NDArray[np.intp],
    first: NDArray[np.int64],
    weights: NDArray[np.float32],
) -> None:
    """Add the light of successive entries of some grid rows, times their shares."""
    total = np.empty(clipped.shape[1], np.float32)
    for n in range(len(rows)):
        total[:] = 0
        for q in range(_LIT_ENTRIES):
            if weights[n, q] > 0:
                entered, weight = light[rows[n], first[n] + q], weights[n, q]
                for j in range(len(total)):
                    total[j] += weight * entered[j]
        for j in range(len(total)):
            clipped[n, j] = total[j]


@kernel
def _sum_chords(
    clipped: Grid, rows_um: Grid, light: Grid, grid_um: Grid, weights: Grid, radius_um: float, step_um: float
) -> None:
    """Add light times the share of the grid cell at each column that lies on the chord at each row."""
    for i in range(len(rows_um)):
        for q in range(len(weights)):
            if abs(rows_um[i, q]) >= radius_um:
                continue
            half_um = np.sqrt(radius_um**2 - rows_um[i, q] ** 2)
            for j in range(len(grid_um)):
                share = min(max((half_um - abs(grid_um[j])) / step_um + 0.5, 0.0), 1.0)
                clipped[i, j] += weights[q] * share * light[i, q]
