"""Sums over the pixels of rows, of which normal equations consist, in vector instructions."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, cast

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from napari_elsplus.processing.vectors import FLOAT, LANES, PLACE, Vectors, are_images, data_of

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np
    from numpy.typing import NDArray

    Image = NDArray[np.float32]

_PAIRS: Final = (
    "t1", "i1", "tt", "ti", "ii", "y1", "x1", "yy", "yx", "xx", "yt", "xt", "ye", "xe", "ge",
    "w1", "ww", "wy", "wx", "wt", "we", "u1", "uu", "ux", "uw", "ut", "ue",
)  # fmt: skip
"""What is multiplied and added up: template t, image i, gradient y of the template along rows and x along columns,
residual e; that times the squared gradient, g; and w and u, the gradients times the distance from a column, by which
pixels move if the image is rotated and stretched. 1 stands for the number 1."""
(T1, I1, TT, TI, II, Y1, X1, YY, YX, XX, YT, XT, YE, XE, GE,
 W1, WW, WY, WX, WT, WE, U1, UU, UX, UW, UT, UE) = range(len(_PAIRS))  # fmt: skip
"""Columns of the moments."""
_WITHOUT_ROTATION: Final = GE + 1
MOMENTS: Final = 32
"""Columns of the moments, in whole vectors."""


def _build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    kinds = signature.args
    template, samples, moments = (data_of(context, builder, kinds[k], arguments[k]) for k in (0, 3, 8))
    at, stride, size, column = arguments[1], arguments[2], arguments[5], arguments[6]
    powers = cgutils.unpack_tuple(builder, arguments[7], len(kinds[7]))
    gain, offset = cgutils.unpack_tuple(builder, arguments[4], 2)
    turns = not isinstance(kinds[6], types.NoneType)
    vectors = Vectors(builder, LANES)
    gain, offset, half = (vectors.spread(value) for value in (gain, offset, FLOAT(0.5)))
    pairs = _PAIRS if turns else _PAIRS[:_WITHOUT_ROTATION]
    zero = ir.Constant(vectors.of(FLOAT), [0.0] * LANES)
    totals = [cgutils.alloca_once(builder, zero.type) for _ in pairs]
    for total in totals:
        builder.store(zero, total)

    def add(first: Any, left: Any = None) -> None:
        """Add a vector of pixels, or as many of them as are left."""

        def pixels(data: Any, begin: Any) -> Any:
            return vectors.load(data, builder.add(begin, first), left)

        values = {"t": pixels(template, at), "i": pixels(samples, PLACE(0))}
        for name, step in (("x", PLACE(1)), ("y", stride)):
            ends = (pixels(template, move(at, step)) for move in (builder.add, builder.sub))
            values[name] = builder.fmul(builder.fsub(*ends), half)
        values["e"] = builder.fsub(builder.fsub(values["i"], builder.fmul(gain, values["t"])), offset)
        if turns:
            here = builder.fadd(column, builder.uitofp(first, FLOAT))
            away = builder.fadd(vectors.spread(here), vectors.ramp())
            values |= {"w": builder.fmul(away, values["y"]), "u": builder.fmul(away, values["x"])}
        squares = (builder.fmul(values[name], values[name]) for name in "yx")
        values["g"] = builder.fmul(builder.fadd(*squares), values["e"])
        for pair, total in zip(pairs, totals, strict=True):
            first, second, before = values[pair[0]], pair[1], builder.load(total)
            after = builder.fadd(before, first) if second == "1" else vectors.fused(first, values[second], before)
            builder.store(after, total)

    length = PLACE(LANES)
    whole = builder.sdiv(size, length)
    with cgutils.for_range(builder, whole) as loop:
        add(builder.mul(loop.index, length))
    done = builder.mul(whole, length)
    with builder.if_then(builder.icmp_signed("<", done, size)):
        add(done, builder.sub(size, done))
    sums = vectors.totals([builder.load(total) for total in totals])
    for group, of_pixels in enumerate(sums):
        exact = builder.fpext(of_pixels, vectors.of(ir.DoubleType()))
        for number, power in enumerate(powers):
            place = PLACE(number * MOMENTS + group * LANES)
            total = vectors.fused(exact, vectors.spread(power), vectors.load(moments, place))
            vectors.store(total, moments, place)
    return context.get_dummy_value()


def _add_row_sums(
    _: Any, template: Any, at: Any, stride: Any, samples: Any, tone: Any, size: Any, column: Any, powers: Any,
    moments: Any,
) -> Any:  # fmt: skip
    """Add sums over a row of an image to moments, each times some factors.

    Parameters
    ----------
    template : numpy.ndarray
        (n, n) float32 image, C-contiguous, whose elements are counted through its rows.
    at, stride : int
        Element of its row's first pixel, and the number of its columns.
    samples : numpy.ndarray
        (m,) float32: what the pixels are compared with.
    tone : tuple of float32
        Gain and offset of the image against the template.
    size : int
        Number of pixels.
    column : float32 or None
        Distance of the first pixel from the column about which the image is rotated; None for sums without w and u.
    powers : tuple of float
        Factors, one for each row of the moments.
    moments : numpy.ndarray
        (p, 32) float64, C-contiguous: sums of products of two quantities.
    """
    if not are_images(template, samples) or moments.layout != "C":
        return None
    place, tones = types.int64, types.UniTuple(types.float32, 2)
    column = column if isinstance(column, types.NoneType) else types.float32
    powers = types.UniTuple(types.float64, len(powers))
    return types.void(template, place, place, samples, tones, place, column, powers, moments), _build


add_row_sums = cast(
    "Callable[[Image, int, int, Image, tuple[np.float32, np.float32], int, np.float32 | None, tuple[float, ...], "
    "NDArray[np.float64]], None]",
    intrinsic(_add_row_sums),
)
