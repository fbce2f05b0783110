"""Rows of the grid smoothed and divided by the flat, in vector instructions.

The kernel 1 4 6 4 1 is applied down the columns of four rows at once, which share what they read, and along the rows
between vectors that are still in the processor's registers.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, cast

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from napari_elsplus.processing.vectors import FLOAT, INT32, Vectors, data_of

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np
    from numpy.typing import NDArray

ROWS: Final = 4
"""Rows that are smoothed together; derived: sides of the grid are multiples of it, as many rows are read besides."""
VECTOR: Final = 16
"""Pixels that are smoothed together; derived: a vector of 512 bits."""
WIDTH: Final = 432
"""Elements from row to row; chosen: constant, so that addresses are, 27 cache lines, so that successive rows lie in
different sets of the nearest cache, and as many as the largest grid of 364 pixels needs with its margins."""
MARGIN: Final = 32
"""Elements before the first pixel of a row; derived: a block may end at that pixel."""
_LINE_BYTES: Final = 4 * VECTOR


def _build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    kinds = signature.args
    rows, factors, out = (data_of(context, builder, kinds[k], arguments[k]) for k in (0, 3, 5))
    upper, lower, factors_at, row = (arguments[k] for k in (1, 2, 4, 6))
    place = upper.type
    side = cgutils.unpack_tuple(builder, context.make_array(kinds[5])(context, builder, arguments[5]).shape, 2)[1]
    halves = [builder.gep(rows, [at]) for at in (upper, lower)]
    factors = builder.gep(factors, [factors_at])
    out = builder.gep(out, [builder.mul(row, side)])
    vectors = Vectors(builder, VECTOR)
    four, six = vectors.same(4.0), vectors.same(6.0)

    def weighted(a: Any, b: Any, c: Any, d: Any, e: Any) -> Any:
        return vectors.fused(four, builder.fadd(b, d), vectors.fused(six, c, builder.fadd(a, e)))

    def down(col: Any) -> list[Any]:
        """Return vectors of the four rows, smoothed down their columns."""
        held = [
            vectors.load(half, builder.add(col, place(k * WIDTH)), align=_LINE_BYTES)
            for half in halves
            for k in range(ROWS)
        ]
        return [weighted(*held[k : k + 5]) for k in range(ROWS)]

    def along(before: Any, here: Any, after: Any) -> Any:
        """Return a vector of a row, smoothed along it between its neighbours."""
        a, b = (vectors.chosen(before, here, range(VECTOR - by, 2 * VECTOR - by)) for by in (2, 1))
        d, e = (vectors.chosen(here, after, range(by, VECTOR + by)) for by in (1, 2))
        return weighted(a, b, here, d, e)

    kept = [[cgutils.alloca_once_value(builder, vector) for vector in down(place(at))] for at in (-VECTOR, 0)]

    def finish(col: Any, left: Any = None) -> None:
        """Finish a vector of each row; of the last ones only the pixels that are `left`."""
        following = down(builder.add(col, place(VECTOR)))
        for k, (before, here, after) in enumerate(zip(*kept, following, strict=True)):
            smooth = along(builder.load(before), builder.load(here), after)
            at = builder.add(builder.mul(col, place(2)), place(2 * WIDTH * k))
            scale, offset = (vectors.load(factors, builder.add(at, place(by)), align=_LINE_BYTES) for by in (0, VECTOR))
            value = builder.fsub(builder.fmul(scale, smooth, flags=("contract",)), offset, flags=("contract",))
            to = builder.add(col, builder.mul(side, place(k)))
            if left is None:
                vectors.store(value, out, to)
                builder.store(builder.load(here), before)
                builder.store(after, here)
            else:
                _store_first(builder, vectors, left, value, builder.gep(out, [to]))

    size = place(VECTOR)
    whole = builder.sdiv(builder.sub(side, place(1)), size)
    with cgutils.for_range(builder, whole) as loop:
        finish(builder.mul(loop.index, size))
    last = builder.mul(whole, size)
    finish(last, builder.sub(side, last))
    return context.get_dummy_value()


def _store_first(builder: Any, vectors: Vectors, count: Any, value: Any, place: Any) -> None:
    """Store the first numbers of a vector of float32 only."""
    pointer, mask = vectors.of(FLOAT).as_pointer(), vectors.of(ir.IntType(1))
    takes = ir.FunctionType(ir.VoidType(), [vectors.of(FLOAT), pointer, INT32, mask])
    function = cgutils.get_or_insert_function(builder.module, takes, f"llvm.masked.store.v{vectors.length}f32.p0")
    inside = builder.fcmp_ordered("<", vectors.ramp(), vectors.spread(builder.sitofp(count, FLOAT)))
    builder.call(function, [value, builder.bitcast(place, pointer), INT32(4), inside])


def _smooth_rows(_: Any, rows: Any, upper: Any, lower: Any, factors: Any, factors_at: Any, out: Any, row: Any) -> Any:
    """Smooth four rows, multiply by the scale and subtract the offset.

    Parameters
    ----------
    rows : numpy.ndarray
        Flat float32, with :data:`WIDTH` elements from row to row, zero beside the rows' pixels, aligned to 64 bytes.
    upper, lower : int
        Elements of the first pixel of the first and of the last four of eight rows, of which the middle four are
        smoothed.
    factors : numpy.ndarray
        Flat float32, likewise aligned: 16 times the scale, 16 times the offset, and so on.
    factors_at : int
        Element of the first factor of the first row.
    out : numpy.ndarray
        (n, n) float32, C-contiguous.
    row : int
        First of the rows.
    """
    del upper, lower, factors_at, row
    whole = types.int64
    if any(kind.layout != "C" for kind in (rows, factors, out)):
        return None
    return types.void(rows, whole, whole, factors, whole, out, whole), _build


smooth_rows = cast(
    "Callable[[NDArray[np.float32], int, int, NDArray[np.float32], int, NDArray[np.float32], int], None]",
    intrinsic(_smooth_rows),
)
