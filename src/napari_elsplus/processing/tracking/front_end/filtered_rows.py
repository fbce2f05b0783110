"""Rows of an image filtered in both directions, in vector instructions."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, cast

from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from napari_elsplus.processing.vectors import LANES, PLACE, Vectors, data_of

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np
    from numpy.typing import NDArray

    Weights = tuple[np.float32, ...]


def _build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    kinds = signature.args
    pixels, out = (data_of(context, builder, kinds[k], arguments[k]) for k in (0, 4))
    begins, down, across = (cgutils.unpack_tuple(builder, arguments[k], len(kinds[k])) for k in (1, 2, 3))
    at, size = arguments[5:]
    vectors, length = Vectors(builder, LANES), PLACE(LANES)
    down, across = ([vectors.spread(weight) for weight in weights] for weights in (down, across))
    read = builder.add(size, PLACE(len(across) - 1))

    def along_columns(first: Any, *, whole: bool) -> Any:
        left = None if whole else builder.sub(read, first)
        rows = [vectors.load(pixels, builder.add(begin, first), left) for begin in begins]
        return vectors.weighted(rows, down)

    before = cgutils.alloca_once_value(builder, along_columns(PLACE(0), whole=False))
    count = builder.sdiv(builder.add(size, PLACE(LANES - 1)), length)
    few = builder.sub(builder.sdiv(read, length), PLACE(1))
    full = builder.select(builder.icmp_signed(">", few, PLACE(0)), few, PLACE(0))
    for begin, end, whole in ((PLACE(0), full, True), (full, count, False)):
        with cgutils.for_range(builder, end, begin) as loop:
            first = builder.mul(loop.index, length)
            here, beyond = builder.load(before), along_columns(builder.add(first, length), whole=whole)
            builder.store(beyond, before)
            shifted = [vectors.chosen(here, beyond, range(k, k + LANES)) for k in range(len(across))]
            vectors.store(vectors.weighted(shifted, across), out, builder.add(at, first))
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
    if any(kind.layout != "C" for kind in (pixels, out)):
        return None
    return types.void(pixels, begins, down, across, out, types.int64, types.int64), _build


filter_row = cast(
    "Callable[[NDArray[np.float32], tuple[int, ...], Weights, Weights, NDArray[np.float32], int, int], None]",
    intrinsic(_filter_row),
)
