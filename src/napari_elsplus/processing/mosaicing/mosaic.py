"""Insertion of frames into a mosaic: unsheared row by row, sub-pixel, as dead leaves or feathered.

The stretch and shear that the probe's motion gave to a frame (``motion.rolling_shutter``) are undone while it is
inserted: each row of the mosaic is interpolated between two rows of the frame, with the same weights along the row.
"""

from __future__ import annotations

from functools import cached_property
from math import ceil, floor, hypot
from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.instrument.arguments import Choice
from napari_elsplus.processing.compiled import lean_kernel, prefetch
from napari_elsplus.processing.mosaicing.exposure import ROW_STEP, exposure_gain, overlap_sums
from napari_elsplus.processing.mosaicing.footprint import Footprint, rows_on_tile
from napari_elsplus.processing.mosaicing.tiles import Rectangle, Tile, TiledCanvas, TileStore, tile_rectangle
from napari_elsplus.processing.tracking.front_end.filtered_rows import lay_row
from napari_elsplus.processing.tracking.front_end.grid import FIELD, Grid, lit_pixels
from napari_elsplus.processing.tracking.motion.rolling_shutter import Velocity
from napari_elsplus.processing.tracking.registration.motion_models import turned_by, unsheared, upright

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.processing.mosaicing.footprint import Arguments
    from napari_elsplus.processing.tracking.motion.pose import Pose

_RAMP: Final = 0.25
"""Fraction of the radius over which weights fall off towards the rim; chosen: wide enough to hide seams."""
_RIM_WEIGHT: Final = 0.02
"""Weight at the rim; chosen: small against 1, and above 0, which marks pixels where nothing was inserted."""
_COVERING_RATIO: Final = 0.5
"""A dead leaf covers a pixel if its weight is at least this fraction of the weight there; chosen: a rim never covers
the inside of another frame, while frames that overlap well cover each other."""
_RENEWED_AFTER: Final = 0.05
"""Motion, in bundle diameters, after which a dead leaf is due; chosen: that between keyframes."""
_MAX_LEFT_OUT: Final = 3
"""Frames in a row that are not due; chosen: at 240 Hz the mosaic is renewed 60 times a second."""
_ROWS_AHEAD: Final = 2
"""Rows of a tile that are prefetched; measured: an insertion by hand, for which the tile is in no near cache, takes 108
us without, 90 with 1 to 3 rows of the tile alone, and 71 with 2 of the weights as well."""
_CACHE_LINE_PX: Final = 16
"""Pixels of a cache line of 64 bytes."""
STILL: Final = Velocity(0.0, 0.0)
"""Velocity of a probe at rest, pixels per frame period."""


class Insertion(Choice):
    """Rule by which a frame is combined with what was inserted before."""

    DEAD_LEAF = "dead-leaf"
    """The newest frame covers the others, as in the paper, but its rim does not cover the inside of another."""
    FEATHERED = "feathered"
    """Mean of all frames, weighted down towards their rims, each scaled to the brightness of what it overlaps."""
    CORES = "cores"
    """Every core of every frame is a sample at its own place; the image that explains them is finer than the cores."""

    @property
    def while_acquiring(self) -> bool:
        """True if frames can be combined by this rule as they arrive."""
        return self is not Insertion.CORES


def rim_weights(grid: Grid, offset_px: float = 0.0) -> NDArray[np.float32]:
    """Weight of each pixel of a frame: 1 inside, falling off towards the rim.

    Parameters
    ----------
    grid : Grid
        The frames' grid.
    offset_px : float
        Slit offset of the calibration in rows of the grid: distance from a point to the laser line while the point's
        residual is read. Where the line is then outside of the bundle nothing is subtracted, and the weight is low.

    Returns
    -------
    numpy.ndarray
        (side, side), float32.
    """
    y, x = (np.arange(grid.side) - c for c in grid.centre)
    radius = 0.5 * FIELD * grid.diameter
    inwards = 1 - np.hypot(y[:, None], x) / radius
    beyond = 1 - np.hypot(y[:, None] + offset_px, x) / (0.5 * grid.diameter)
    depth = np.minimum(inwards, beyond)
    if grid.seen is not None:
        top, bottom, left, right = grid.seen
        rows, cols = np.arange(grid.side)[:, None], np.arange(grid.side)
        from_frame = np.minimum(np.minimum(rows + 1 - top, bottom - rows), np.minimum(cols + 1 - left, right - cols))
        depth = np.minimum(depth, from_frame / radius)
    ramp = np.clip(depth / _RAMP, 0, 1)
    weights: NDArray[np.float32] = np.maximum(ramp * ramp * (3 - 2 * ramp), _RIM_WEIGHT).astype(np.float32)
    return weights


class Mosaic(TiledCanvas):
    """Mosaic of one segment on an unbounded canvas; pixels are those of the tracking grid.

    One thread inserts; any thread may read.

    Parameters
    ----------
    grid : Grid
        The frames' grid.
    insertion : Insertion
        Rule by which frames are combined.
    weights : numpy.ndarray, optional
        (side, side) float32 weight of each pixel of a frame; :func:`rim_weights` by default.
    store : TileStore, optional
        Storage of the tiles; the heap by default.

    Attributes
    ----------
    exposure : float
        Factor by which the grey levels of the last frame were multiplied.
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
        self._newest: tuple[float, float, float] | None = None
        self._left_out = 0
        self._upright, self._upright_weights, self._exposed_image = (np.empty_like(self._weights) for _ in range(3))

    def insert(
        self,
        image: NDArray[np.float32],
        row: float,
        col: float,
        velocity: Velocity = STILL,
        angle: float = 0.0,
        clarity: NDArray[np.float32] | None = None,
    ) -> Rectangle:
        """Insert a frame with its centre at (row, col).

        Parameters
        ----------
        image : numpy.ndarray
            (side, side) float32.
        row, col : float
            Position of the probe when the bundle's middle row was read, pixels of the grid.
        velocity : Velocity
            Velocity of the probe during the frame, pixels per frame period.
        angle : float
            Rotation of the probe in radians, from rows towards columns; a rotated frame is resampled upright first.
        clarity : numpy.ndarray, optional
            (side, side) float32 by which the weights of its pixels are multiplied, as of
            :class:`~napari_elsplus.processing.mosaicing.clarity.Clarity`; all frames of a mosaic have one, or none has.

        Returns
        -------
        Rectangle
            Part of the canvas that may have changed.
        """
        self._newest, self._left_out = (row, col, angle), 0
        image, footprint = self._placed(image, row, col, velocity, angle, clarity)
        touched = self._extent(row, col, *self._stretch_and_shear(velocity, angle))
        blend = self.insertion is Insertion.FEATHERED
        with self._lock:
            if blend:
                self.exposure = self._exposure_gain(image, touched, footprint)
                if self.exposure != 1:
                    image = np.multiply(image, np.float32(self.exposure), out=self._exposed_image)
            for key in touched.tiles():
                tile, at = self._store.tile(*key), tile_rectangle(*key)
                insert_rows(*tile, at.top, at.left, image, footprint, blend)
            self._mark_drawn(touched)
        return touched

    def due(self, pose: Pose) -> bool:
        """Return True if the next frame is worth inserting, given its `pose`; called once for each frame.

        A dead leaf is only if the probe has moved since the newest one, or a few frames were left out: it would cover
        that one with the same.
        """
        if self.insertion is not Insertion.DEAD_LEAF or self._newest is None:
            return True
        row, col, angle = self._newest
        moved = hypot(pose.row - row, pose.col - col) / self.grid.diameter + abs(pose.angle - angle) / 2
        self._left_out += 1
        return moved >= _RENEWED_AFTER or self._left_out > _MAX_LEFT_OUT

    def extent_of(self, pose: Pose) -> Rectangle:
        """Return the part of the canvas that a frame with a pose covers at most."""
        return self._extent(pose.row, pose.col, *self._stretch_and_shear(pose.velocity, pose.angle))

    def render_into(self, tile: Tile, key: tuple[int, int], image: NDArray[np.float32], pose: Pose) -> None:
        """Insert a frame into a tile beside the canvas, for re-rendering; its brightness is not adjusted.

        Parameters
        ----------
        tile : Tile
            Modified in place.
        key : tuple of int
            Row and column of the tile on the canvas.
        image : numpy.ndarray
            (side, side) float32.
        pose : Pose
            Corrected pose of the frame.
        """
        image, footprint = self._placed(image, pose.row, pose.col, pose.velocity, pose.angle)
        at = tile_rectangle(*key)
        insert_rows(*tile, at.top, at.left, image, footprint, self.insertion is Insertion.FEATHERED)

    def replace_tile(self, key: tuple[int, int], tile: Tile, drawn: Rectangle | None) -> None:
        """Replace the content of a tile of the canvas.

        Parameters
        ----------
        key : tuple of int
            Row and column of the tile on the canvas.
        tile : Tile
            New content; copied.
        drawn : Rectangle or None
            Part of the canvas in which the new content has frames; extends the canvas' extent.
        """
        with self._lock:
            own = self._store.tile(*key)
            own.value[:], own.weight[:] = tile
            if drawn is not None:
                self._mark_drawn(drawn)
            if self.extent is not None:
                changed = tile_rectangle(*key).intersection(self.extent)
                self._dirty = changed if self._dirty is None else self._dirty.union(changed)

    def _extent(self, row: float, col: float, stretch: float, shear: float) -> Rectangle:
        """Return the rectangle around the disc of a frame that is used."""
        radius = 0.5 * FIELD * self.grid.diameter
        down, across = radius * stretch, radius * (1 + abs(shear))
        return Rectangle(floor(row - down), floor(col - across), ceil(row + down) + 1, ceil(col + across) + 1)

    def _stretch_and_shear(self, velocity: Velocity, angle: float) -> tuple[float, float]:
        """Return the stretch and shear that the kernels undo: none where :meth:`_placed` resamples the whole frame."""
        r = self.grid.shutter.line_periods_per_frame
        return (1.0, 0.0) if angle != 0 else (1 + velocity.row / r, velocity.col / r)

    def _placed(
        self,
        image: NDArray[np.float32],
        row: float,
        col: float,
        velocity: Velocity,
        angle: float,
        clarity: NDArray[np.float32] | None = None,
    ) -> tuple[NDArray[np.float32], Arguments]:
        """Return a frame and its footprint; one that is rotated is resampled onto the canvas' own pixels."""
        image = np.ascontiguousarray(image, np.float32)  # as the kernel reads it
        weights = self._weights if clarity is None else self._weights * clarity
        centre = self.grid.centre
        if angle != 0:
            matrix = turned_by(angle) @ unsheared(velocity, self.grid.shutter.line_periods_per_frame)
            onto = round(row - centre[0]) + centre[0], round(col - centre[1]) + centre[1]
            shift = row - onto[0], col - onto[1]
            image = upright(image, self._upright, centre, matrix, shift)
            weights = upright(weights, self._upright_weights, centre, matrix, shift)
            row, col = onto
        stretch, shear = self._stretch_and_shear(velocity, angle)
        footprint = Footprint(weights, *self._spans, *centre, row, col, stretch, shear)
        return image, footprint.arguments

    @cached_property
    def _frame_weight(self) -> float:
        """Sum of the weights of a frame, as :func:`overlap_sums` adds them up."""
        return float(self._weights[lit_pixels(*self._spans)].sum()) / ROW_STEP

    def _exposure_gain(self, image: NDArray[np.float32], touched: Rectangle, footprint: Arguments) -> float:
        """Return the factor that brings a frame to the brightness of the mosaic under its footprint."""
        sums = np.zeros(3)
        for key in touched.tiles():
            tile, at = self._store.tile(*key), tile_rectangle(*key)
            sums += overlap_sums(*tile, at.top, at.left, image, footprint)
        canvas, frame, weight = sums.tolist()
        return exposure_gain(canvas, frame, weight, self._frame_weight)


@lean_kernel
def insert_rows(
    value: NDArray[np.float32],
    weight: NDArray[np.float32],
    top: int,
    left: int,
    image: NDArray[np.float32],
    footprint: Arguments,
    blend: bool,
) -> None:
    """Insert into a tile the part of an upright frame that falls on it.

    Parameters
    ----------
    value, weight : numpy.ndarray
        The tile's arrays, float32; modified in place.
    top, left : int
        Row and column of the mosaic of the tile's first pixel.
    image : numpy.ndarray
        (side, side) float32.
    footprint : tuple
        :attr:`Footprint.arguments` of the frame.
    blend : bool
        Add up weighted grey levels and weights; otherwise replace what the frame covers.
    """
    image_weight, first, last, centre_row, centre_col, row, col, stretch, shear = footprint
    height, width = value.shape
    side = image.shape[0]
    for r in range(*rows_on_tile(footprint, top, height)):
        y = (r + top - row) / stretch
        at = y + centre_row
        above = int(np.floor(at))
        if above < 0 or above + 1 >= side:
            continue
        down = at - above
        if down == 0.0:
            low, high = first[above], last[above]
        else:
            low, high = max(first[above], first[above + 1]), min(last[above], last[above + 1])
        shift = left + centre_col - col - shear * y
        whole = int(np.floor(shift))
        across = shift - whole
        begin, end = max(0, low - whole), min(width, high - whole - (1 if across > 0 else 0))
        if end <= begin:
            continue
        for k in range(begin, end + _CACHE_LINE_PX - 1, _CACHE_LINE_PX):
            prefetch(value, r + _ROWS_AHEAD, k)
            prefetch(weight, r + _ROWS_AHEAD, k)
            prefetch(image_weight, above + _ROWS_AHEAD, k + whole)
        nearest = above + (1 if down >= 0.5 else 0)
        aside = whole + (1 if across >= 0.5 else 0)
        pixel = above * side + begin + whole
        upper, near = (np.float32(1 - down), np.float32(down)), (np.float32(1 - across), np.float32(across))
        lay_row(
            image, (pixel, pixel + side), upper, near, image_weight, nearest * side + begin + aside, value, weight,
            r * width + begin, end - begin, np.float32(_COVERING_RATIO), blend,
        )  # fmt: skip
