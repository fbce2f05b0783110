"""A growing mosaic as a multiscale image: levels are read lazily, and only changed parts are recomputed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from napari_elsplus.processing.analysis.image_quality import white_level
from napari_elsplus.processing.mosaicing.pyramid import Pyramid
from napari_elsplus.processing.mosaicing.sheet import Sheet
from napari_elsplus.processing.mosaicing.tiles import Canvas, Rectangle

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray


LEVELS: Final = 8
"""Levels of the pyramid, each half of the one before: 512 pixels become 65,000."""
FRAME_STEP_PX: Final = 2 << (LEVELS - 1)
"""Multiple to which the image's edges are rounded, pixels: two pixels of the last level."""
COARSEST_PX: Final = 512
"""Largest side of the last displayed level, pixels; chosen, one tile of a screen."""
SATURATED_FRACTION: Final = 1e-3
"""Fraction of a mosaic's pixels displayed as white; chosen, so that single bright cores do not set the contrast."""


class Change(NamedTuple):
    """Result of an update.

    Parameters
    ----------
    pixels : bool
        True if any pixel may have changed.
    frame : bool
        True if the image covers another part of the plane: its levels are new arrays.
    places : bool
        True if a segment has moved on the sheet.
    """

    pixels: bool = False
    frame: bool = False
    places: bool = False


class GrowingImage:
    """The segments of a mosaic as the levels of a multiscale image.

    Attributes
    ----------
    sheet : Sheet
        Layout of the segments.
    frame : Rectangle
        Part of the sheet that the image covers.
    levels : list
        Full resolution first, each half of the one before, NaN where nothing was drawn. All but the last read the
        mosaic when indexed; the last is an array that is updated in place.

    Examples
    --------
    >>> from napari_elsplus.processing.tracking.front_end.grid import Grid
    >>> from napari_elsplus.processing.mosaicing.mosaic import Mosaic
    >>> from napari_elsplus.processing.tracking.motion.rolling_shutter import RollingShutter
    >>> mosaic = Mosaic(Grid(120, 1, (0, 0), (59.5, 59.5), 116.0, RollingShutter(150.0)))
    >>> _ = mosaic.insert(np.full((120, 120), 7, np.float32), 0.0, 0.0)
    >>> image = GrowingImage()
    >>> image.update({0: mosaic})
    Change(pixels=True, frame=True, places=False)
    >>> [level.shape for level in image.levels], image.frame
    ([(512, 512), (256, 256)], Rectangle(top=-256, left=-256, bottom=256, right=256))
    >>> float(image.levels[0][256, 256]), image.update({0: mosaic}).pixels
    (7.0, False)
    """

    def __init__(self) -> None:
        self.sheet = Sheet()
        self.frame = Rectangle(0, 0, 0, 0)
        self._pyramid = Pyramid(self.sheet, LEVELS)
        self._coarsest = np.zeros((0, 0), np.float32)
        self.levels: list[Any] = []

    def update(self, canvases: Mapping[int, Canvas], like: Sheet | None = None) -> Change:
        """Include what was inserted since the last call; call it in one thread only.

        Parameters
        ----------
        canvases : mapping of int to Canvas
            Segments by number.
        like : Sheet, optional
            Layout to copy.
        """
        moved = self.sheet.arrange(canvases, like)
        dirty = self._pyramid.refresh()
        frame = (self.sheet.drawn or self.frame).aligned(FRAME_STEP_PX)  # it seldom changes
        reframed = frame != self.frame
        if reframed:
            self.frame = frame
            count = _levels_of(frame)
            self._coarsest = _read(self._pyramid, count - 1, _halved(frame, count - 1))
            self.levels = [LevelView(self._pyramid, level, frame) for level in range(count - 1)] + [self._coarsest]
        elif dirty:
            self._fill_coarsest(dirty[len(self.levels) - 1])
        return Change(bool(dirty), reframed, moved)

    @property
    def white_level(self) -> float:
        """Grey level displayed as white."""
        return white_level(self._coarsest, SATURATED_FRACTION)

    @property
    def covered_px(self) -> float:
        """Number of covered pixels, estimated from the last level."""
        return float(np.count_nonzero(np.isfinite(self._coarsest)) << 2 * max(len(self.levels) - 1, 0))

    def _fill_coarsest(self, dirty: Rectangle) -> None:
        level = len(self.levels) - 1
        whole = _halved(self.frame, level)
        part = dirty.intersection(whole)
        if 0 not in part.shape:
            self._coarsest[part.slices(whole)] = _read(self._pyramid, level, part)


class LevelView:
    """One level of a pyramid as a lazy float32 array.

    Parameters
    ----------
    pyramid : Pyramid
        Source of the pixels.
    level : int
        Index of the level, 0 is full resolution.
    frame : Rectangle
        Part that the array covers, in pixels of level 0; its edges are multiples of every level's pixel.
    """

    ndim: Final = 2
    dtype: Final = np.dtype(np.float32)

    def __init__(self, pyramid: Pyramid, level: int, frame: Rectangle) -> None:
        self._pyramid, self._level = pyramid, level
        self._part = _halved(frame, level)
        self.shape = self._part.shape
        self.size = self.shape[0] * self.shape[1]

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, key: Any) -> Any:
        keys = key if isinstance(key, tuple) else (key,)
        if Ellipsis in keys or len(keys) > self.ndim:
            return np.asarray(self)[key]
        keys = (*keys, *[slice(None)] * (self.ndim - len(keys)))
        bounds: list[tuple[int, int]] = []
        rest: list[slice | int] = []
        for one, length in zip(keys, self.shape, strict=True):
            if isinstance(one, slice):
                first, last, step = one.indices(length)
                if step < 1:
                    return np.asarray(self)[key]
                bounds.append((first, max(first, last)))
                rest.append(slice(None, None, step))
            else:
                index = int(one)
                if not -length <= index < length:
                    raise IndexError(f"pixel {index} of {length}")
                bounds.append((index % length, index % length + 1))
                rest.append(0)
        (top, bottom), (left, right) = bounds
        part = Rectangle(top, left, bottom, right).translated(self._part.top, self._part.left)
        return _read(self._pyramid, self._level, part)[tuple(rest)]

    def __deepcopy__(self, _: dict[int, Any]) -> NDArray[Any]:
        """Return its pixels, which a layer that the user duplicates keeps while the mosaic grows or is cleared."""
        return np.asarray(self)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        whole = _read(self._pyramid, self._level, self._part)
        return whole if dtype is None else whole.astype(dtype, copy=False)


def _read(pyramid: Pyramid, level: int, part: Rectangle) -> NDArray[np.float32]:
    """Copy a part of a level of a pyramid, NaN where nothing was drawn: napari displays that as transparent."""
    image, weight = pyramid.read(level, part)
    image[weight == 0] = np.nan
    return image


def _halved(frame: Rectangle, level: int) -> Rectangle:
    return Rectangle(*(edge >> level for edge in frame))


def _levels_of(frame: Rectangle) -> int:
    """Return the number of displayed levels: at least two, so that the image is multiscale from the beginning."""
    return next((n for n in range(2, LEVELS) if max(frame.shape) >> (n - 1) <= COARSEST_PX), LEVELS)
