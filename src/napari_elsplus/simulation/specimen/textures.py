"""Textures of planes of tissue: brightness at any point, computed on demand.

A texture is sampled on a grid in micrometres and draws its objects softened by that grid's step, so that coarse grids
do not alias. Generators place their objects by hashing lattice cells: they have no edge, take no memory, and give the
same tissue at the same position whatever the path of the probe.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Protocol

import numpy as np

from napari_elsplus.processing.compiled import kernel

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Axis = NDArray[np.float64]
    Picture = NDArray[np.float32]


class Texture(Protocol):
    """Brightness of a plane."""

    @property
    def bounds_um(self) -> tuple[float, float, float, float] | None:
        """First row, first column, last row, last column of a finite texture; None where it has no edge."""

    def sample(self, rows_um: Axis, cols_um: Axis) -> Picture:
        """Return the brightness (rows, cols), float32, on a regular grid of rows and columns, um."""


def step_um(axis_um: Axis) -> float:
    """Return the step, um, of a regular grid along an axis."""
    return float(axis_um[1] - axis_um[0])


@dataclass(frozen=True)
class Uniform:
    """The same brightness everywhere."""

    bounds_um: None = None

    def sample(self, rows_um: Axis, cols_um: Axis) -> Picture:
        """See :meth:`Texture.sample`."""
        return np.ones((len(rows_um), len(cols_um)), np.float32)


@dataclass(frozen=True)
class Fibres:
    """Curved fibres, as in stained lens tissue.

    Parameters
    ----------
    per_mm2 : float
        Fibres per square millimetre (by their middles).
    width_um : float
        Mean width.
    length_um : float
        Mean length.
    seed : int
        Seed of the tissue.
    """

    per_mm2: float = 60.0
    width_um: float = 12.0
    length_um: float = 500.0
    seed: int = 0
    bounds_um: None = None

    def sample(self, rows_um: Axis, cols_um: Axis) -> Picture:
        """See :meth:`Texture.sample`."""
        out = np.zeros((len(rows_um), len(cols_um)), np.float32)
        reach = 0.75 * self.length_um + 2 * self.width_um
        cells = (
            range(int(np.floor((axis[0] - reach) / _CELL_UM)), int(np.floor((axis[-1] + reach) / _CELL_UM)) + 1)
            for axis in (rows_um, cols_um)
        )
        draw_fibres(out, rows_um[0], cols_um[0], step_um(rows_um), _fibres_of_cells(self, *cells))
        return out


_CELL_UM = 250.0
"""Side of a lattice cell, um; chosen."""
_POINTS_PER_FIBRE = 9
"""Points of the polyline of a fibre; chosen."""


@lru_cache(maxsize=64)
def _fibres_of_cells(fibres: Fibres, rows: range, cols: range) -> Picture:
    """Fibres of all cells, (fibres, points, 4)."""
    found = [fibre for i in rows for j in cols for fibre in _fibres_of_cell(fibres, i, j)]
    return np.array(found, np.float32).reshape(-1, _POINTS_PER_FIBRE, 4)


@lru_cache(maxsize=4096)
def _fibres_of_cell(fibres: Fibres, i: int, j: int) -> list[Picture]:
    """Fibres whose middle lies in a cell; each (points, 4): row, col, half width (um), brightness."""
    rng = np.random.default_rng((fibres.seed, i + (1 << 31), j + (1 << 31)))
    made = []
    along = np.linspace(-0.5, 0.5, _POINTS_PER_FIBRE)
    for _ in range(rng.poisson(fibres.per_mm2 * (_CELL_UM / 1000) ** 2)):
        middle = (np.array([i, j]) + rng.random(2)) * _CELL_UM
        length = fibres.length_um * rng.uniform(0.5, 1.5)
        angle, bend = rng.uniform(0, np.pi), rng.normal(0, 0.5)
        heading = angle + bend * along
        path = np.cumsum(np.stack([np.sin(heading), np.cos(heading)], 1), 0) * (length / _POINTS_PER_FIBRE)
        path += middle - path[_POINTS_PER_FIBRE // 2]
        half_width = 0.5 * fibres.width_um * rng.uniform(0.6, 1.4)
        rest = np.broadcast_to([half_width, rng.uniform(0.55, 1.0)], (_POINTS_PER_FIBRE, 2))
        made.append(np.hstack([path, rest]).astype(np.float32))
    return made


@kernel
def _draw_fibre(out: Picture, row0: float, col0: float, step: float, fibre: Picture) -> None:
    half = fibre[0, 2]
    bright = fibre[0, 3]
    soft = max(step, 0.25 * half)
    reach = half + soft
    for k in range(len(fibre) - 1):
        ay, ax, by, bx = fibre[k, 0], fibre[k, 1], fibre[k + 1, 0], fibre[k + 1, 1]
        dy, dx = by - ay, bx - ax
        inverse = 1 / (dy * dy + dx * dx)
        strip = reach / np.sqrt(inverse)  # across the segment, times its length
        first = max(0, int(np.ceil((min(ay, by) - reach - row0) / step)))
        last = min(out.shape[0] - 1, int((max(ay, by) + reach - row0) / step))
        left = max(0, int(np.ceil((min(ax, bx) - reach - col0) / step)))
        right = min(out.shape[1] - 1, int((max(ax, bx) + reach - col0) / step))
        for i in range(first, last + 1):
            y = row0 + i * step - ay
            begin, end = left, right
            if abs(dy) > 1e-3:
                low, high = (y * dx - strip) / dy, (y * dx + strip) / dy
                begin = max(left, int(np.floor((ax + min(low, high) - col0) / step)))
                end = min(right, int(np.ceil((ax + max(low, high) - col0) / step)))
            for j in range(begin, end + 1):
                x = col0 + j * step - ax
                t = min(1.0, max(0.0, (y * dy + x * dx) * inverse))
                away = np.sqrt((y - t * dy) ** 2 + (x - t * dx) ** 2)
                inside = min(1.0, max(0.0, 0.5 + (half - away) / soft))
                value = bright * inside * (1 - 0.35 * min(1.0, (away / half) ** 2))
                out[i, j] = max(out[i, j], value)


@kernel
def draw_fibres(out: Picture, row0: float, col0: float, step: float, fibres: Picture) -> None:
    """Draw fibres into a picture whose first pixel lies at (row0, col0), each pixel a step further, micrometres.

    Parameters
    ----------
    out : numpy.ndarray
        (rows, cols) float32, drawn into; where fibres cross, the brighter one is seen.
    row0, col0, step : float
        Where its pixels lie.
    fibres : numpy.ndarray
        (fibres, points, 4) float32: row, col, half width, brightness.
    """
    for n in range(len(fibres)):
        _draw_fibre(out, row0, col0, step, fibres[n])


@dataclass(frozen=True)
class Nuclei:
    """Bright nuclei on a dimmer, mottled cytoplasm, as acriflavine stains an epithelium.

    Parameters
    ----------
    spacing_um : float
        Mean distance of neighbouring nuclei.
    radius_um : float
        Mean radius of a nucleus.
    seed : int
        Seed of the tissue.
    """

    spacing_um: float = 15.0
    radius_um: float = 4.0
    seed: int = 0
    bounds_um: None = None

    def sample(self, rows_um: Axis, cols_um: Axis) -> Picture:
        """See :meth:`Texture.sample`."""
        out = np.zeros((len(rows_um), len(cols_um)), np.float32)
        _draw_mottle(out, rows_um[0], cols_um[0], step_um(rows_um), 60.0, self.seed)
        out *= 0.25
        _draw_nuclei(out, rows_um[0], cols_um[0], step_um(rows_um), self.spacing_um, self.radius_um, self.seed)
        return out


@dataclass(frozen=True)
class Mottle:
    """A ground of slowly varying brightness around 1.

    Parameters
    ----------
    scale_um : float
        Size of its patches.
    seed : int
        Seed of the ground.
    """

    scale_um: float = 150.0
    seed: int = 0
    bounds_um: None = None

    def sample(self, rows_um: Axis, cols_um: Axis) -> Picture:
        """See :meth:`Texture.sample`."""
        out = np.zeros((len(rows_um), len(cols_um)), np.float32)
        _draw_mottle(out, rows_um[0], cols_um[0], step_um(rows_um), self.scale_um, self.seed)
        return 0.5 + out


@kernel
def _chance(i: int, j: int, salt: int) -> float:
    """Uniform number in [0, 1) that belongs to a lattice cell: a 64-bit mix of its indices."""
    word = np.uint64(i) * np.uint64(0x9E3779B97F4A7C15) ^ np.uint64(j) * np.uint64(0xC2B2AE3D27D4EB4F)
    word ^= np.uint64(salt) * np.uint64(0x165667B19E3779F9)
    for _ in range(2):
        word ^= word >> np.uint64(32)
        word *= np.uint64(0xD6E8FEB86659FD93)
    word ^= word >> np.uint64(32)
    return float(word >> np.uint64(11)) / float(1 << 53)


@kernel
def _draw_mottle(out: Picture, row0: float, col0: float, step: float, scale: float, seed: int) -> None:
    for i in range(out.shape[0]):
        y = (row0 + i * step) / scale
        iy = int(np.floor(y))
        fy = y - iy
        fy = fy * fy * (3 - 2 * fy)
        corner = int(np.floor(col0 / scale))
        left = (1 - fy) * _chance(iy, corner, seed) + fy * _chance(iy + 1, corner, seed)
        right = (1 - fy) * _chance(iy, corner + 1, seed) + fy * _chance(iy + 1, corner + 1, seed)
        for j in range(out.shape[1]):
            x = (col0 + j * step) / scale
            while x >= corner + 1:
                corner += 1
                left = right
                right = (1 - fy) * _chance(iy, corner + 1, seed) + fy * _chance(iy + 1, corner + 1, seed)
            fx = x - corner
            fx = fx * fx * (3 - 2 * fx)
            out[i, j] = (1 - fx) * left + fx * right


@kernel
def _draw_nuclei(out: Picture, row0: float, col0: float, step: float, spacing: float, radius: float, seed: int) -> None:
    reach = 1.5 * radius + step
    first_i = int(np.floor((row0 - reach) / spacing)) - 1
    last_i = int(np.floor((row0 + (out.shape[0] - 1) * step + reach) / spacing)) + 1
    first_j = int(np.floor((col0 - reach) / spacing)) - 1
    last_j = int(np.floor((col0 + (out.shape[1] - 1) * step + reach) / spacing)) + 1
    for ci in range(first_i, last_i + 1):
        for cj in range(first_j, last_j + 1):
            y0 = (ci + 0.15 + 0.7 * _chance(ci, cj, seed + 1)) * spacing
            x0 = (cj + 0.5 * (ci & 1) + 0.15 + 0.7 * _chance(ci, cj, seed + 2)) * spacing
            angle = np.pi * _chance(ci, cj, seed + 3)
            a = radius * (0.75 + 0.6 * _chance(ci, cj, seed + 4))
            b = a * (0.6 + 0.4 * _chance(ci, cj, seed + 5))
            bright = 0.5 + 0.5 * _chance(ci, cj, seed + 6)
            cos, sin = np.cos(angle), np.sin(angle)
            soft = max(step, 0.3 * b)
            top = max(0, int(np.ceil((y0 - a - soft - row0) / step)))
            bottom = min(out.shape[0] - 1, int(np.floor((y0 + a + soft - row0) / step)))
            left = max(0, int(np.ceil((x0 - a - soft - col0) / step)))
            right = min(out.shape[1] - 1, int(np.floor((x0 + a + soft - col0) / step)))
            for i in range(top, bottom + 1):
                y = row0 + i * step - y0
                for j in range(left, right + 1):
                    x = col0 + j * step - x0
                    along = (x * cos + y * sin) / a
                    across = (y * cos - x * sin) / b
                    inside = 0.5 + (1 - np.sqrt(along * along + across * across)) * b / soft
                    out[i, j] = max(out[i, j], bright * min(1.0, max(0.0, inside)))
