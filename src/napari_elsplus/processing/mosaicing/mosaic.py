"""Frames laid into a mosaic: unsheared row by row, to a fraction of a pixel, as dead leaves or blended.

A frame is first freed of the stretch and shear that its own motion gave it
(``motion.rolling_shutter``): each row of the mosaic then takes its pixels from one place between
two rows of the frame, so that the interpolation weights of a row are constants.
"""

from __future__ import annotations

from enum import StrEnum
from math import ceil, floor
from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.processing.compiled import lean_kernel
from napari_elsplus.processing.mosaicing.exposure import ROW_STEP, Overlap, exposure_gain, overlap_sums
from napari_elsplus.processing.mosaicing.tiles import Rectangle, Tile, TiledCanvas, TileStore, tile_rectangle
from napari_elsplus.processing.tracking.front_end.grid import FIELD, lit_pixels
from napari_elsplus.processing.tracking.front_end.sampling import between, bilinear, neighbours
from napari_elsplus.processing.tracking.motion.rolling_shutter import Velocity
from napari_elsplus.processing.tracking.registration.motion_models import turned_by, unsheared, upright

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.front_end.grid import Grid

_RAMP: Final = 0.25
"""Part of the radius over which the weight of a frame falls off towards its rim."""
_RIM_WEIGHT: Final = 0.02
_OUTWEIGHS: Final = 0.5
"""A dead leaf covers what lies there unless its weight is less than this part of it."""
STILL: Final = Velocity(0.0, 0.0)


class Insertion(StrEnum):
    """How a frame is laid over those before it."""

    DEAD_LEAF = "dead-leaf"
    """The newest frame covers the others, as in the paper, but its rim does not cover the inside of another."""
    FEATHERED = "feathered"
    """The mean of all frames, weighted down towards their rims, each brought to the brightness of what it overlaps."""


def rim_weights(grid: Grid, line_away: float = 0.0) -> NDArray[np.float32]:
    """Weight of each pixel of a frame: 1 inside, falling off towards the rim.

    Parameters
    ----------
    grid : Grid
        The frames' grid.
    line_away : float
        Rows of the grid from a point to the laser line at the time at which the point's residual is read: the offset of
        the calibration. Where the line is then outside of the bundle nothing is subtracted, and the weight is low.

    Returns
    -------
    numpy.ndarray
        (side, side), float32.
    """
    y, x = (np.arange(grid.side) - c for c in grid.centre)
    radius = 0.5 * FIELD * grid.diameter
    inwards = 1 - np.hypot(y[:, None], x) / radius
    beyond = 1 - np.hypot(y[:, None] + line_away, x) / (0.5 * grid.diameter)
    ramp = np.clip(np.minimum(inwards, beyond) / _RAMP, 0, 1)
    weights: NDArray[np.float32] = np.maximum(ramp * ramp * (3 - 2 * ramp), _RIM_WEIGHT).astype(np.float32)
    return weights


class Mosaic(TiledCanvas):
    """Frames of one segment on a canvas without edges; pixels are those of the tracking grid.

    One thread inserts; any thread may read.

    Parameters
    ----------
    grid : Grid
        The frames' grid.
    insertion : Insertion
        How frames are laid over one another.
    weights : numpy.ndarray, optional
        (side, side) float32 weight of each pixel of a frame; :func:`rim_weights` by default.
    store : TileStore, optional
        Where the tiles are kept; the heap by default.

    Attributes
    ----------
    exposure : float
        What the last frame's grey levels were multiplied by.
    """

    def __init__(
        self,
        grid: Grid,
        insertion: Insertion | str = Insertion.DEAD_LEAF,
        *,
        weights: NDArray[np.float32] | None = None,
        store: TileStore | None = None,
    ) -> None:
        self.grid = grid
        self.insertion = Insertion(insertion)
        super().__init__(store, blended=self.insertion is Insertion.FEATHERED)
        self._weights = rim_weights(grid) if weights is None else weights
        self._spans = grid.spans()
        self.exposure = 1.0
        self._turned = np.zeros((grid.side, grid.side), np.float32)
        self._exposed_image = np.zeros_like(self._turned)
        self._whole_weight = float(self._weights[lit_pixels(*self._spans)].sum()) / ROW_STEP

    def insert(
        self,
        image: NDArray[np.float32],
        row: float,
        col: float,
        velocity: Velocity = STILL,
        angle: float = 0.0,
        scale: float = 1.0,
    ) -> Rectangle:
        """Lay a frame down with its centre at (row, col).

        Parameters
        ----------
        image : numpy.ndarray
            (side, side) float32.
        row, col : float
            Where the probe was when the bundle's middle row was read, in pixels of the grid.
        velocity : Velocity
            Of the probe during the frame, in pixels per frame period.
        angle : float
            Of the probe, in radians from rows towards columns: a turned frame is turned back as a whole.
        scale : float
            Pixels of the mosaic per pixel of the frame.

        Returns
        -------
        Rectangle
            The part of the canvas that may have changed.
        """
        touched = self.extent_of(row, col, velocity, angle, scale)
        image, stretch, shear = self._seated(image, velocity, angle, scale)
        blend = self.insertion is Insertion.FEATHERED
        with self._lock:
            if blend:
                self.exposure = self._exposure(image, touched, row, col, stretch, shear)
                if self.exposure != 1:
                    image = np.multiply(image, np.float32(self.exposure), out=self._exposed_image)
            for key in touched.tiles():
                tile, at = self._store.tile(*key), tile_rectangle(*key)
                insert_rows(
                    tile.value, tile.weight, at.top, at.left, image, self._weights, *self._spans,
                    *self.grid.centre, row, col, stretch, shear, blend,
                )  # fmt: skip
            self._touched(touched)
        return touched

    def extent_of(
        self, row: float, col: float, velocity: Velocity = STILL, angle: float = 0.0, scale: float = 1.0
    ) -> Rectangle:
        """Return the part of the canvas that :meth:`insert` may change."""
        stretch, shear = self._form(velocity, angle, scale)
        radius = 0.5 * FIELD * self.grid.diameter
        down, across = radius * stretch, radius * (1 + abs(shear))
        return Rectangle(floor(row - down), floor(col - across), ceil(row + down) + 1, ceil(col + across) + 1)

    def render_into(
        self,
        tile: Tile,
        key: tuple[int, int],
        image: NDArray[np.float32],
        row: float,
        col: float,
        velocity: Velocity = STILL,
        angle: float = 0.0,
        scale: float = 1.0,
    ) -> None:
        """Do on a tile that is not on the canvas what :meth:`insert` does there; the brightness is left as it is."""
        image, stretch, shear = self._seated(image, velocity, angle, scale)
        at = tile_rectangle(*key)
        insert_rows(
            tile.value, tile.weight, at.top, at.left, image, self._weights, *self._spans,
            *self.grid.centre, row, col, stretch, shear, self.insertion is Insertion.FEATHERED,
        )  # fmt: skip

    def replace_tile(self, key: tuple[int, int], tile: Tile, drawn: Rectangle | None) -> None:
        """Put another tile's content, of which some part was drawn on, in the place of the canvas's own."""
        with self._lock:
            own = self._store.tile(*key)
            own.value[:], own.weight[:] = tile
            if drawn is not None:
                self._touched(drawn)
            if self.extent is not None:
                changed = tile_rectangle(*key).intersection(self.extent)
                self._dirty = changed if self._dirty is None else self._dirty.union(changed)

    def _form(self, velocity: Velocity, angle: float, scale: float) -> tuple[float, float]:
        """Stretch and shear that are undone row by row; a turned frame is freed of its own before."""
        r = self.grid.shutter.line_periods_per_frame
        upright_before = angle != 0 or scale != 1
        return (1.0, 0.0) if upright_before else (1 + velocity.row / r, velocity.col / r)

    def _seated(
        self, image: NDArray[np.float32], velocity: Velocity, angle: float, scale: float
    ) -> tuple[NDArray[np.float32], float, float]:
        """Turn a frame upright where it is turned; return it with its stretch and shear."""
        if angle != 0 or scale != 1:
            matrix = turned_by(angle, scale) @ unsheared(velocity, self.grid.shutter.line_periods_per_frame)
            image = upright(image, self._turned, self.grid.centre, matrix)
        return (image, *self._form(velocity, angle, scale))

    def _exposure(
        self, image: NDArray[np.float32], touched: Rectangle, row: float, col: float, stretch: float, shear: float
    ) -> float:
        """Return what brings a frame to the brightness of what lies where it will lie."""
        sums = np.zeros(3)
        for key in touched.tiles():
            tile, at = self._store.tile(*key), tile_rectangle(*key)
            sums += overlap_sums(
                tile.value, tile.weight, at.top, at.left, image, self._weights, *self._spans,
                *self.grid.centre, row, col, stretch, shear,
            )  # fmt: skip
        return exposure_gain(Overlap(*sums.tolist()), self._whole_weight)


@lean_kernel
def insert_rows(
    value: NDArray[np.float32],
    weight: NDArray[np.float32],
    tile_top: int,
    tile_left: int,
    image: NDArray[np.float32],
    image_weight: NDArray[np.float32],
    first: NDArray[np.int32],
    last: NDArray[np.int32],
    centre_row: float,
    centre_col: float,
    row: float,
    col: float,
    stretch: float,
    shear: float,
    blend: bool,
) -> None:
    """Draw the part of an unsheared frame that falls on one tile."""
    height, width = value.shape
    side = image.shape[0]
    radius = stretch * side
    begin_row = max(0, int(np.floor(row - radius)) - tile_top)
    end_row = min(height, int(np.ceil(row + radius)) + 1 - tile_top)
    for r in range(begin_row, end_row):
        y = (r + tile_top - row) / stretch
        at = y + centre_row
        above = int(np.floor(at))
        if above < 0 or above + 1 >= side:
            continue
        down = at - above
        if down == 0.0:
            low, high = first[above], last[above]
        else:
            low, high = max(first[above], first[above + 1]), min(last[above], last[above + 1])
        shift = tile_left + centre_col - col - shear * y
        whole = int(np.floor(shift))
        across = shift - whole
        begin, end = max(0, low - whole), min(width, high - whole - (1 if across > 0 else 0))
        if end <= begin:
            continue
        corners, parts = neighbours(image, above, begin + whole, end - begin), bilinear(down, across)
        nearest = above + (1 if down >= 0.5 else 0)
        aside = whole + (1 if across >= 0.5 else 0)
        weights = image_weight[nearest, begin + aside : end + aside]
        into, had = value[r, begin:end], weight[r, begin:end]
        if blend:
            for k in range(end - begin):
                new = between(corners, parts, k)
                into[k] += weights[k] * new
                had[k] += weights[k]
        else:
            for k in range(end - begin):
                new = between(corners, parts, k)
                lies, outweighs, heavy = into[k], had[k], weights[k]
                covers = heavy >= np.float32(_OUTWEIGHS) * outweighs  # all is read before, so that this is no branch
                into[k] = new if covers else lies
                had[k] = heavy if covers else outweighs
