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
        self._disc = inside.reshape(points, 8, points, 8).mean((1, 3))
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
        narrow = self._core_um * np.sqrt(pull)
        rows = (self.grid_um + pull * offsets_um)[:, None] + narrow * _NODES
        chord = self._chord(rows, spread_um)
        return np.asarray(np.einsum("q,iqj->ij", _NODE_WEIGHTS, chord))

    def _halo(self, offsets_um: Grid, spread_um: float) -> Grid:
        unclipped = _gaussian(offsets_um, float(np.hypot(self._halo_um, spread_um)))
        visible = unclipped > 1e-9
        if spread_um == 0:
            origin, along_cols = self._entering(offsets_um)
            along_rows = _gaussian(self.grid_um[:, None] - origin, self._inner_um)
            clipped = np.einsum("iq,iqj->ij", along_rows, along_cols)
        else:
            clipped = self._collected_halo(offsets_um, self._collected(spread_um))
        return np.asarray(np.where(visible[:, None], clipped / np.maximum(unclipped, 1e-9)[:, None], 1.0))

    def _entering(self, offsets_um: Grid) -> tuple[Grid, Grid]:
        """Rows on which the laser enters while each grid row is read, (points, nodes), and its light along them."""
        rows_um = (self.grid_um + offsets_um)[:, None] + self._core_um * _NODES
        return rows_um, self._on_chord(rows_um) * _NODE_WEIGHTS[:, None]

    def _collected_halo(self, offsets_um: Grid, collect: Grid) -> Grid:
        """Halo light that leaves the bundle while each grid row is read, collected onto that row: (points, columns)."""
        arrays = (*self._entering(offsets_um), self.grid_um, collect, self._disc)
        rows_um, along_cols, grid_um, weights, disc = (array.astype(np.float32) for array in arrays)  # in half the time
        points, nodes = rows_um.shape
        along_rows = _gaussian(grid_um - rows_um[..., None], self._inner_um) * weights[:, None, :]
        leaving = (along_rows.reshape(-1, points) @ disc).reshape(points, nodes, points)
        return np.asarray(np.einsum("iqj,iqj->ij", leaving, along_cols) @ weights.T)

    def _on_chord(self, rows_um: Grid) -> Grid:
        """Share of the grid cell at each column that lies on the chord at each row; 0 off the bundle."""
        half = np.sqrt(np.maximum(self.radius_um**2 - rows_um**2, 0.0))[..., None]
        return np.asarray(np.clip((half - np.abs(self.grid_um)) / self._step_um + 0.5, 0, 1) * (half > 0))

    def _chord(self, rows_um: Grid, sigma_um: float) -> Grid:
        """Share of a Gaussian around each grid column that falls onto the chord at each row; 0 off the bundle."""
        half = np.sqrt(np.maximum(self.radius_um**2 - rows_um**2, 0.0))[..., None]
        scale = 1 / (np.sqrt(2) * sigma_um)
        right = self.grid_um[len(self.grid_um) // 2 :]
        shares = 0.5 * (erf((half - right) * scale) + erf((half + right) * scale))
        return np.concatenate([shares[..., ::-1], shares], axis=-1)

    def _collected(self, spread_um: float) -> Grid:
        """Share that each grid cell (last axis) gives to each grid point."""
        edges = erf((self._cell_edges[None, :] - self.grid_um[:, None]) / (np.sqrt(2) * spread_um))
        return np.asarray(0.5 * np.diff(edges, axis=1))


def _gaussian(offset_um: NDArray[np.floating], sigma_um: float) -> NDArray[np.floating]:
    return np.asarray(np.exp(-0.5 * (offset_um / sigma_um) ** 2) / (np.sqrt(2 * np.pi) * sigma_um))
