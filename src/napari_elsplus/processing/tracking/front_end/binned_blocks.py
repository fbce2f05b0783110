"""Rows of the grid in vector instructions: blocks of both views binned and subtracted, and rows smoothed.

A square that lies between camera pixels is interpolated between the four squares on whole pixels around it. Sums of
camera pixels are exact integers, which are converted to float32 once for each pixel of the grid.
"""

from __future__ import annotations

from functools import reduce
from typing import TYPE_CHECKING, Any, Final, cast

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from napari_elsplus.processing.compiled import build_prefetch
from napari_elsplus.processing.vectors import FLOAT, PLACE, Vectors, are_images, data_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from numpy.typing import NDArray

BLOCK: Final = 32
"""Pixels of the grid in a block; derived: with two camera pixels of a byte each they fill a vector of 512 bits, the
longest there is."""
AHEAD: Final = 96
"""Number of blocks, some twelve rows, ahead of which the camera's memory is prefetched; chosen: between 24 and 240 it
makes no difference beyond its scatter."""
VECTOR: Final = 16
"""Pixels of the grid that are smoothed at once: a vector of 512 bits."""
CAMERA_KINDS: Final = (np.dtype(np.uint8), np.dtype(np.uint16), np.dtype(np.float32))
"""Kinds of camera pixels that are binned."""


class _Camera:
    """Sums of a row of camera pixels, in instructions for one kind of them; `less` is the difference of two sums.

    Parameters
    ----------
    builder : llvmlite.ir.IRBuilder
        Of the kernel.
    kind : numba.types.Type
        Of the camera pixels.
    binning : int
        Camera pixels per pixel of the grid.
    """

    def __init__(self, builder: Any, kind: Any, binning: int) -> None:
        self._builder, self._bits, self._binning = builder, kind.bitwidth, binning
        self._vectors = Vectors(builder, BLOCK)
        self._exact: Any = None
        """Integers that hold the sum of a square; None where pixels, and so sums, are float32."""
        if isinstance(kind, types.Integer):
            self._exact = ir.IntType(16 if binning**2 << self._bits < 2**15 else 32)
        self._add, self.less = (builder.add, builder.sub) if self._exact else (builder.fadd, builder.fsub)

    def added(self, numbers: Iterable[Any]) -> Any:
        """Return the sum of vectors of pixels."""
        return reduce(self._add, numbers)

    def real(self, total: Any) -> Any:
        """Return a sum or difference as float32."""
        return self._builder.sitofp(total, self._vectors.of(FLOAT)) if self._exact else total

    def columns(self, data: Any, element: Any) -> list[Any]:
        """Return the first, second, ... camera pixel of each pixel of the grid, from an element of a frame on."""
        many = ir.VectorType(data.type.pointee, self._binning * BLOCK)
        place = self._builder.bitcast(self._builder.gep(data, [element]), many.as_pointer())
        pixels = self._builder.load(place, align=self._bits // 8)
        if self._exact and self._exact.width == self._binning * self._bits:
            return self._parts(self._builder.bitcast(pixels, self._vectors.of(self._exact)))
        every = range(0, self._binning * BLOCK, self._binning)
        chosen = [self._vectors.chosen(pixels, pixels, [first + k for k in every]) for first in range(self._binning)]
        return [self._builder.zext(one, self._vectors.of(self._exact)) for one in chosen] if self._exact else chosen

    def _parts(self, together: Any) -> list[Any]:
        """Return the first, second, ... of the pixels that are one integer together, its lowest bits first."""
        width, numbers = self._bits, self._vectors.of(self._exact)
        mask = ir.Constant(numbers, [2**width - 1] * BLOCK)
        shifted = (
            self._builder.lshr(together, ir.Constant(numbers, [k * width] * BLOCK)) for k in range(self._binning)
        )
        return [self._builder.and_(part, mask) for part in shifted]


def _build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    kinds = signature.args
    raw, raw_residual, places, fractions, rows = (
        data_of(context, builder, kinds[k], arguments[k]) for k in (0, 1, 3, 4, 8)
    )
    binning = len(kinds[2])
    which, slopes, weights = arguments[5:8]
    cols = cgutils.unpack_tuple(builder, context.make_array(kinds[0])(context, builder, arguments[0]).shape, 2)[1]
    vectors, camera = Vectors(builder, BLOCK), _Camera(builder, kinds[0].dtype, binning)
    tilt, growth = (builder.fmul(vectors.spread(s), vectors.ramp()) for s in cgutils.unpack_tuple(builder, slopes, 2))
    of_confocal, of_residual = (vectors.spread(w) for w in cgutils.unpack_tuple(builder, weights, 2))

    def entry(table: Any, n: Any, k: int, size: int) -> Any:
        return builder.load(builder.gep(table, [builder.add(builder.mul(n, PLACE(size)), PLACE(k))]))

    def corners(n: Any) -> list[Any]:
        return [builder.sext(entry(places, n, k, 4), PLACE) for k in (0, 1)]

    def pixel(corner: Any, row: int, col: int) -> Any:
        return builder.add(builder.add(corner, builder.mul(cols, PLACE(row))), PLACE(col))

    def squares(data: Any, corner: Any, row: int) -> tuple[Any, Any]:
        """Return the sums of a row of the squares, and of those one camera pixel aside."""
        here = camera.columns(data, pixel(corner, row, 0))
        beyond = camera.columns(data, pixel(corner, row, 1))[-1]
        return camera.added(here), camera.added([*here[1:], beyond])

    begin, end = cgutils.unpack_tuple(builder, which, 2)
    with cgutils.for_range(builder, end, begin) as loop:
        n = loop.index
        later = corners(builder.add(n, PLACE(AHEAD)))
        for row in range(binning):
            build_prefetch(builder, builder.gep(raw, [pixel(later[0], row, 0)]))
            build_prefetch(builder, builder.gep(raw_residual, [pixel(later[1], row + 1, 0)]))
        confocal, residual = corners(n)
        down, across = (
            builder.fadd(vectors.spread(entry(fractions, n, k, 2)), slope) for k, slope in enumerate((tilt, growth))
        )
        whole = camera.added([camera.added(camera.columns(raw, pixel(confocal, row, 0))) for row in range(binning)])
        lines = [squares(raw_residual, residual, row) for row in range(binning + 1)]
        upper, upper_aside = (camera.added(sums[:binning]) for sums in zip(*lines, strict=True))
        more, more_aside = (camera.less(lines[-1][k], lines[0][k]) for k in (0, 1))
        above = vectors.fused(across, camera.real(camera.less(upper_aside, upper)), camera.real(upper))
        step = vectors.fused(across, camera.real(camera.less(more_aside, more)), camera.real(more))
        between = vectors.fused(down, step, above)
        value = vectors.fused(between, of_residual, builder.fmul(camera.real(whole), of_confocal))
        to = builder.sext(entry(places, n, 2, 4), PLACE)
        filled = builder.bitcast(entry(places, n, 3, 4), vectors.of(ir.IntType(1)))
        vectors.store(builder.select(filled, value, vectors.load(rows, to)), rows, to)
    return context.get_dummy_value()


def _bin_blocks(
    _: Any, raw: Any, raw_residual: Any, pixels: Any, places: Any, fractions: Any, which: Any, slopes: Any,
    weights: Any, rows: Any,
) -> Any:  # fmt: skip
    """Fill blocks of the rows of the grid.

    Parameters
    ----------
    raw, raw_residual : numpy.ndarray
        (rows, cols), C-contiguous, of :data:`CAMERA_KINDS`: frames that the confocal and the residual view are taken
        from.
    pixels : tuple of int
        0, 1, ...: as many as there are camera pixels per pixel of the grid in a row.
    places, fractions, slopes : numpy.ndarray, numpy.ndarray, tuple of float32
        Of :class:`~napari_elsplus.processing.tracking.front_end.binning.ViewBlocks`.
    which : tuple of int
        The first of the blocks, and the one after the last.
    weights : tuple of float32
        Of the two views.
    rows : numpy.ndarray
        Flat float32.
    """
    indices, pair = types.UniTuple(types.int64, 2), types.UniTuple(types.float32, 2)
    if any(kind.layout != "C" for kind in (raw, raw_residual, places, fractions, rows)):
        return None
    return types.void(raw, raw_residual, pixels, places, fractions, indices, pair, pair, rows), _build


bin_blocks = cast(
    "Callable[[NDArray[Any], NDArray[Any], tuple[int, ...], NDArray[np.int32], NDArray[np.float32], tuple[int, int], "
    "tuple[np.float32, np.float32], tuple[np.float32, np.float32], NDArray[np.float32]], None]",
    intrinsic(_bin_blocks),
)


def _build_smoothing(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    rows, scale, offset, out = (data_of(context, builder, signature.args[k], arguments[k]) for k in (0, 2, 3, 4))
    begins, (at, count) = cgutils.unpack_tuple(builder, arguments[1], 5), arguments[5:]
    vectors = Vectors(builder, VECTOR)
    four, six = (ir.Constant(vectors.of(FLOAT), [weight] * VECTOR) for weight in (4.0, 6.0))

    def smoothed(five: list[Any]) -> Any:
        outer, inner = builder.fadd(five[0], five[4]), builder.fadd(five[1], five[3])
        return vectors.fused(six, five[2], vectors.fused(four, inner, outer))

    def along_columns(first: Any) -> Any:
        return smoothed([vectors.load(rows, builder.add(begin, first)) for begin in begins])

    left = cgutils.alloca_once_value(builder, along_columns(PLACE(0)))
    with cgutils.for_range(builder, count) as loop:
        first = builder.mul(loop.index, PLACE(VECTOR))
        here, beyond = builder.load(left), along_columns(builder.add(first, PLACE(VECTOR)))
        builder.store(beyond, left)
        value = smoothed([vectors.chosen(here, beyond, range(k, k + VECTOR)) for k in range(5)])
        to = builder.add(at, first)
        value = builder.fmul(value, vectors.load(scale, to))
        vectors.store(builder.fsub(value, vectors.load(offset, to)), out, to)
    return context.get_dummy_value()


def _smooth_row(_: Any, rows: Any, begins: Any, scale: Any, offset: Any, out: Any, at: Any, count: Any) -> Any:
    """Smooth a row by 1 4 6 4 1 in both directions, multiply by a scale, and subtract an offset.

    Parameters
    ----------
    rows : numpy.ndarray
        Flat float32: binned rows.
    begins : tuple of int
        Elements of five of them, from top to bottom, two columns before the first pixel.
    scale, offset, out : numpy.ndarray
        Flat float32 images; `out` is filled.
    at, count : int
        Element of the first pixel in the images, and the number of vectors.
    """
    if not are_images(rows, scale, offset, out):
        return None
    return types.void(
        rows, types.UniTuple(types.int64, 5), scale, offset, out, types.int64, types.int64
    ), _build_smoothing


smooth_row = cast(
    "Callable[[NDArray[np.float32], tuple[int, ...], NDArray[np.float32], NDArray[np.float32], NDArray[np.float32], "
    "int, int], None]",
    intrinsic(_smooth_row),
)
