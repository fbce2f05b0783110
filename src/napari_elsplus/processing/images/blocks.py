"""Interpolation of blocks of sixteen neighbouring pixels by twelve taps, in vector instructions.

Within a block the taps lie at the same pixels, and the fraction of a pixel changes evenly from pixel to pixel: the
weights are expanded to second order about a tabulated fraction. Rows that lie a pixel apart share the weights.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any, Final, cast

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from napari_elsplus.processing.images.resampling import LOBES, taps

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Interpolation = Callable[
        [
            NDArray[np.float32],
            int,
            int,
            NDArray[np.float32],
            int,
            np.float32,
            np.float32,
            NDArray[np.float32],
            int,
            int,
        ],
        None,
    ]

BLOCK: Final = 16
"""Pixels of a block; derived: a vector of 512 bits, the longest there is."""
TAPS: Final = 2 * LOBES
"""Pixels from which one is interpolated along a row or column; derived."""
PHASES: Final = 64
"""Number of tabulated fractions of a pixel; derived: half a step is far below :data:`MAX_EXPANSION_PX`."""
MAX_EXPANSION_PX: Final = 0.12
"""Largest distance from a tabulated fraction, pixels; derived: the second-order expansion then leaves an error of 0.8 %
at 0.48 cycles per pixel, that of the core pattern."""


@cache
def expanded_weights() -> NDArray[np.float32]:
    """Return the weights at each tabulated fraction, their first and half their second derivative: (65, 36) float32."""
    fractions, step = np.arange(PHASES + 1) / PHASES, 1e-2
    below, here, above = (taps(fractions + by).astype(float) for by in (-step, 0, step))
    return np.hstack([here, (above - below) / (2 * step), (above - 2 * here + below) / (2 * step**2)]).astype(
        np.float32
    )


def interpolation(rows: int, *, along_rows: bool) -> Interpolation:
    """Return the function, for use in kernels, that interpolates a block of some rows.

    Its arguments: the flat image, the element of the first tap, elements from row to row; the flat weights, the first
    element of those at a tabulated fraction, the distance of the block's first pixel from that fraction and its change
    from pixel to pixel; the flat result, the element of its first pixel, elements from row to row.

    Parameters
    ----------
    rows : int
        Rows that share weights.
    along_rows : bool
        Interpolate between rows; otherwise between columns.
    """

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        vector = ir.VectorType(ir.FloatType(), BLOCK)
        image, weights, out = (
            context.make_array(signature.args[k])(context, builder, arguments[k]).data for k in (0, 3, 7)
        )
        _, at, row_step, _, phase, offset, slope, _, to, out_step = arguments

        def chain(element: Any, step: Any, count: int) -> list[Any]:
            places = [builder.gep(image, [element])]
            for _ in range(count - 1):
                places.append(builder.gep(places[-1], [step]))
            return places

        def weight_of(order: int, tap: int) -> Any:
            element = builder.add(phase, ir.Constant(phase.type, order * TAPS + tap))
            return spread(builder.load(builder.gep(weights, [element])))

        def along_row(place: Any, tap: int) -> Any:
            return builder.gep(place, [ir.Constant(at.type, tap)])

        def spread(value: Any) -> Any:
            one = builder.insert_element(ir.Constant(vector, ir.Undefined), value, ir.IntType(32)(0))
            return builder.shuffle_vector(one, one, ir.Constant(ir.VectorType(ir.IntType(32), BLOCK), [0] * BLOCK))

        def fused(a: Any, b: Any, c: Any) -> Any:
            return builder.fadd(builder.fmul(a, b, flags=("contract",)), c, flags=("contract",))

        ramp = ir.Constant(vector, [float(t) for t in range(BLOCK)])
        beyond = fused(spread(slope), ramp, spread(offset))
        lines = chain(at, row_step, rows + (TAPS - 1 if along_rows else 0))
        sums: list[Any] = [None] * rows
        for k in range(TAPS):
            value, first, second = (weight_of(order, k) for order in range(3))
            weight = fused(fused(second, beyond, first), beyond, value)
            for r in range(rows):
                place = lines[r + k] if along_rows else along_row(lines[r], k)
                pixels = builder.load(builder.bitcast(place, vector.as_pointer()), align=4)
                sums[r] = builder.fmul(weight, pixels) if k == 0 else fused(weight, pixels, sums[r])
        for r in range(rows):
            place = builder.gep(out, [builder.add(to, builder.mul(out_step, ir.Constant(to.type, r)))])
            builder.store(sums[r], builder.bitcast(place, vector.as_pointer()), align=4)
        return context.get_dummy_value()

    def interpolate(
        _: Any,
        image: Any,
        at: Any,
        row_step: Any,
        weights: Any,
        phase: Any,
        offset: Any,
        slope: Any,
        out: Any,
        to: Any,
        out_step: Any,
    ) -> Any:
        whole, real = types.int64, types.float32
        return types.void(image, whole, whole, weights, whole, real, real, out, whole, whole), build

    return cast("Interpolation", intrinsic(interpolate))
