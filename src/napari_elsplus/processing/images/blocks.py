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
from napari_elsplus.processing.vectors import Vectors, data_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Interpolation = Callable[..., None]
    """Of the arguments that :func:`interpolation` names."""

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
        vectors = Vectors(builder, BLOCK)
        image, weights, out = (data_of(context, builder, signature.args[k], arguments[k]) for k in (0, 3, 7))
        _, at, row_step, _, phase, offset, slope, _, to, out_step = arguments

        def weight_of(order: int, tap: int) -> Any:
            element = builder.add(phase, ir.Constant(phase.type, order * TAPS + tap))
            return vectors.spread(builder.load(builder.gep(weights, [element])))

        lines = [at]
        for _ in range(rows - 1 + (TAPS - 1 if along_rows else 0)):
            lines.append(builder.add(lines[-1], row_step))
        beyond = vectors.fused(vectors.spread(slope), vectors.ramp(), vectors.spread(offset))
        sums: list[Any] = [None] * rows
        for k in range(TAPS):
            value, first, second = (weight_of(order, k) for order in range(3))
            weight = vectors.fused(vectors.fused(second, beyond, first), beyond, value)
            for r in range(rows):
                element = lines[r + k] if along_rows else builder.add(lines[r], ir.Constant(at.type, k))
                pixels = vectors.load(image, element)
                sums[r] = builder.fmul(weight, pixels) if k == 0 else vectors.fused(weight, pixels, sums[r])
        for r in range(rows):
            vectors.store(sums[r], out, builder.add(to, builder.mul(out_step, ir.Constant(to.type, r))))
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
