"""Rows of an image filtered in both directions, in vector instructions."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, cast

from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from napari_elsplus.processing.vectors import LANES, PLACE, Vectors, are_images, data_of

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np
    from numpy.typing import NDArray

    Weights = tuple[np.float32, ...]


def _filtered(
    builder: Any, vectors: Vectors, pixels: Any, begins: list[Any], weights: tuple[list[Any], list[Any]], size: Any,
    take: Callable[[Any, Any, Any], None],
) -> None:  # fmt: skip
    """Build the loop over a run of pixels, in vectors; `take` receives its first pixel, it, and how many are left.

    The last is None for a whole vector.
    """
    down, across = ([vectors.spread(weight) for weight in each] for each in weights)
    length, read = PLACE(vectors.length), builder.add(size, PLACE(len(across) - 1))

    def along_columns(first: Any, *, whole: bool) -> Any:
        left = None if whole else builder.sub(read, first)
        rows = [vectors.load(pixels, builder.add(begin, first), left) for begin in begins]
        return vectors.weighted(rows, down)

    before = cgutils.alloca_once_value(builder, along_columns(PLACE(0), whole=False))
    count = builder.sdiv(builder.add(size, PLACE(vectors.length - 1)), length)
    few = builder.sub(builder.sdiv(read, length), PLACE(1))
    full = builder.select(builder.icmp_signed(">", few, PLACE(0)), few, PLACE(0))
    for begin, end, whole in ((PLACE(0), full, True), (full, count, False)):
        with cgutils.for_range(builder, end, begin) as loop:
            first = builder.mul(loop.index, length)
            here, beyond = builder.load(before), along_columns(builder.add(first, length), whole=whole)
            builder.store(beyond, before)
            shifted = [vectors.chosen(here, beyond, range(k, k + vectors.length)) for k in range(len(across))]
            take(first, vectors.weighted(shifted, across), None if whole else builder.sub(size, first))


def _build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    kinds, vectors = signature.args, Vectors(builder, LANES)
    pixels, out = (data_of(context, builder, kinds[k], arguments[k]) for k in (0, 4))
    begins, down, across = (cgutils.unpack_tuple(builder, arguments[k], len(kinds[k])) for k in (1, 2, 3))
    at, size = arguments[5:]

    def take(first: Any, value: Any, left: Any) -> None:
        del left
        vectors.store(value, out, builder.add(at, first))

    _filtered(builder, vectors, pixels, begins, (down, across), size, take)
    return context.get_dummy_value()


def _build_laying(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    kinds, vectors = signature.args, Vectors(builder, LANES)
    pixels, image_weight, value, weight = (data_of(context, builder, kinds[k], arguments[k]) for k in (0, 4, 6, 7))
    begins, down, across = (cgutils.unpack_tuple(builder, arguments[k], len(kinds[k])) for k in (1, 2, 3))
    (heavy_at, at), (size, ratio, blend) = (arguments[5], arguments[8]), arguments[9:]
    ratio = vectors.spread(ratio)

    def take(first: Any, new: Any, left: Any) -> None:
        to = builder.add(at, first)
        heavy = vectors.load(image_weight, builder.add(heavy_at, first), left)
        lies, had = (vectors.load(data, to, left) for data in (value, weight))
        covers = builder.fcmp_ordered(">=", heavy, builder.fmul(ratio, had))
        for data, covering, below, added in ((value, new, lies, builder.fmul(heavy, new)), (weight, heavy, had, heavy)):
            covered = builder.select(covers, covering, below)
            vectors.store(builder.select(blend, builder.fadd(below, added), covered), data, to, left)

    _filtered(builder, vectors, pixels, begins, (down, across), size, take)
    return context.get_dummy_value()


def _filter_row(
    _: Any, pixels: Any, begins: Any, down: Any, across: Any, out: Any, at: Any, size: Any
) -> Any:  # fmt: skip
    """Fill a run of pixels with weighted sums of those of some rows, in whole vectors: beyond it with anything.

    Parameters
    ----------
    pixels : numpy.ndarray
        C-contiguous float32, whose elements are counted through its rows.
    begins : tuple of int
        Element of the first pixel of each row that is read.
    down, across : tuple of float32
        Weights of the rows, and of successive pixels.
    out : numpy.ndarray
        The same, with room for whole vectors.
    at, size : int
        Element of the first pixel that is filled, and their number.
    """
    if not are_images(pixels, out):
        return None
    return types.void(pixels, begins, down, across, out, types.int64, types.int64), _build


filter_row = cast(
    "Callable[[NDArray[np.float32], tuple[int, ...], Weights, Weights, NDArray[np.float32], int, int], None]",
    intrinsic(_filter_row),
)


def _lay_row(
    _: Any, pixels: Any, begins: Any, down: Any, across: Any, image_weight: Any, heavy_at: Any, value: Any, weight: Any,
    at: Any, size: Any, ratio: Any, blend: Any,
) -> Any:  # fmt: skip
    """Lay a filtered row onto a run of pixels: replace them and their weights where it weighs enough, or add it up.

    Parameters
    ----------
    pixels, begins, down, across
        As of :func:`filter_row`.
    image_weight, heavy_at : numpy.ndarray, int
        C-contiguous float32, and the element of the weight of the row's first pixel.
    value, weight, at : numpy.ndarray, numpy.ndarray, int
        C-contiguous float32, and the element of the first pixel that may be replaced, and its weight.
    size : int
        Number of pixels.
    ratio : float32
        Least weight over the one that is there.
    blend : bool
        Add up weighted pixels and weights instead.
    """
    if not are_images(pixels, image_weight, value, weight):
        return None
    place, images = types.int64, (image_weight, types.int64, value, weight)
    arguments = pixels, begins, down, across, *images, place, place, types.float32, types.boolean
    return types.void(*arguments), _build_laying


lay_row = cast(
    "Callable[[NDArray[np.float32], tuple[int, ...], Weights, Weights, NDArray[np.float32], int, NDArray[np.float32], "
    "NDArray[np.float32], int, int, np.float32, bool], None]",
    intrinsic(_lay_row),
)
