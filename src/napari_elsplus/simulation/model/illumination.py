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
from typing import TYPE_CHECKING, Final

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


@lru_cache(maxsize=4)
def edge(radius_um: float, line: LineModel, slit_um: float) -> Edge:
    """Return the vignetting of a bundle, cached; parameters as of :class:`Edge`."""
    return Edge(radius_um, line, slit_um)


class Edge:
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
        step = self.grid_um[1] - self.grid_um[0]
        fine = (np.arange(8) + 0.5) / 8 - 0.5
        rows = (self.grid_um[:, None] + step * fine).ravel()
        inside = rows[:, None] ** 2 + rows[None, :] ** 2 <= radius_um**2
        self._disc = inside.reshape(points, 8, points, 8).mean((1, 3)).astype(np.float32)
        self._collecting: dict[float, Grid] = {}
        self._step_um = float(step)
        self._cell_edges = np.append(self.grid_um - step / 2, self.grid_um[-1] + step / 2)

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
        rows_um = self._around((self.grid_um + offsets_um)[visible], self._core_um)
        grid_um, radius_um, height = self.grid_um, self.radius_um, 1 / (np.sqrt(2 * np.pi) * self._inner_um)
        clipped = np.zeros((len(visible), len(grid_um)))
        if spread_um == 0:
            own = np.repeat(grid_um[visible, None], len(_NODES), 1)
            along_rows = _bells((own - rows_um) / self._inner_um, BELL) * height
            _sum_chords(clipped, rows_um, along_rows[..., None], grid_um, _NODE_WEIGHTS, radius_um, self._step_um)
        else:  # in single precision: in half the time
            collect = self._collected(spread_um)
            leaving = np.empty((len(visible), len(_NODES), len(grid_um)), np.float32)
            _leave(leaving, rows_um, grid_um, collect[visible], height, self._inner_um, BELL)
            leaving = (leaving.reshape(-1, len(grid_um)) @ self._disc).reshape(leaving.shape)
            _sum_chords(clipped, rows_um, leaving, grid_um, _NODE_WEIGHTS, radius_um, self._step_um)
            clipped = clipped @ collect.T
        result[visible] = clipped / unclipped[visible, None]
        return result

    def _around(self, rows_um: Grid, sigma_um: float) -> Grid:
        """Return rows at the nodes of a Gaussian around each row, (rows, nodes)."""
        return np.asarray(rows_um[:, None] + sigma_um * _NODES)

    def _collected(self, spread_um: float) -> Grid:
        """Share that each grid cell (last axis) gives to each grid point."""
        if spread_um not in self._collecting:
            edges = erf((self._cell_edges[None, :] - self.grid_um[:, None]) / (np.sqrt(2) * spread_um))
            self._collecting[spread_um] = np.asarray(0.5 * np.diff(edges, axis=1))
        return self._collecting[spread_um]


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
def _leave(
    leaving: NDArray[np.float32],
    rows_um: Grid,
    grid_um: Grid,
    collect: Grid,
    height: float,
    inner_um: float,
    table: Grid,
) -> None:
    """Write the halo that leaves on each row of the grid and is collected, for light that enters on some rows."""
    for i in range(len(rows_um)):
        for q in range(rows_um.shape[1]):
            for g in range(len(grid_um)):
                leaving[i, q, g] = height * bell(table, (grid_um[g] - rows_um[i, q]) / inner_um) * collect[i, g]


@kernel
def _sum_chords(
    clipped: Grid,
    rows_um: Grid,
    light: NDArray[np.floating],
    grid_um: Grid,
    weights: Grid,
    radius_um: float,
    step_um: float,
) -> None:
    """Add light times the share of the grid cell at each column that lies on the chord at each row."""
    wide = light.shape[2] > 1
    for i in range(len(rows_um)):
        for q in range(len(weights)):
            if abs(rows_um[i, q]) >= radius_um:
                continue
            half_um = np.sqrt(radius_um**2 - rows_um[i, q] ** 2)
            for j in range(len(grid_um)):
                share = min(max((half_um - abs(grid_um[j])) / step_um + 0.5, 0.0), 1.0)
                clipped[i, j] += weights[q] * share * light[i, q, j if wide else 0]
