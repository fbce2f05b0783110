"""Frames sampled between their pixels, a row at a time.

Every row of the rolling shutter's warp is shifted by one amount, so its interpolation weights are constants and a pass
over a frame is a handful of vector operations. Two kinds: between four pixels, which is fast; and on a polynomial
through six by six, for the last hundredth of a pixel. Linear interpolation moves fine structure towards the nearer
pixel; at an even speed every frame has the same sub-pixel phase, and the error adds up frame after frame.

References
----------
Thevenaz, Blu and Unser, IEEE Trans. Med. Imaging 19, 739 (2000), doi:10.1109/42.875199.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from napari_elsplus.processing.compiled import compilable, lean_kernel
from napari_elsplus.processing.tracking.front_end.filtered_rows import filter_row
from napari_elsplus.processing.vectors import LANES, aligned_zeros

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.motion.rolling_shutter import Warp

_BEFORE: Final = 2
_AFTER: Final = 3
"""Pixels of the polynomial before the one that a sample follows, and after it."""


class FramePair(NamedTuple):
    """Two frames of one resolution that are compared.

    Parameters
    ----------
    template, image : numpy.ndarray
        (n, n) float32: the earlier frame, and the later one, which is sampled under a warp.
    first, last : numpy.ndarray
        (n,) int32: first lit column of each row, and the one after the last.
    middle : float
        Row of the bundle's centre.
    """

    template: NDArray[np.float32]
    image: NDArray[np.float32]
    first: NDArray[np.int32]
    last: NDArray[np.int32]
    middle: float


def scratch(side: int) -> NDArray[np.float32]:
    """Return memory for samples of a row of an image with so many columns, `side`, in whole vectors."""
    return aligned_zeros(side + LANES)


@lean_kernel
def row_shift(pair: FramePair, row: int, warp: Warp) -> tuple[int, float, int, float, int, int]:
    """Return the shift of one row of the template in the image, and the columns in which both are lit.

    These are the image row above and the fraction below it, the whole column shift and its fraction, the first column
    and the one after the last; nothing overlaps where the last two are equal.

    Parameters
    ----------
    pair : FramePair
        Frames that are compared.
    row : int
        Row of the template.
    warp : Warp
        From the template to the image.
    """
    first, last, middle = pair.first, pair.last, pair.middle
    y = row - middle
    at = warp.a * y + warp.b + middle
    shift = warp.s * y + warp.d
    above = int(np.floor(at))
    whole = int(np.floor(shift))
    if above < 0 or above + 1 >= len(pair.image):
        return 0, 0.0, 0, 0.0, 0, 0
    begin = max(first[row], max(first[above], first[above + 1]) - whole)
    end = min(last[row], min(last[above], last[above + 1]) - whole - 1)
    return above, at - above, whole, shift - whole, begin, max(begin, end)


@lean_kernel
def reaches(shape: tuple[int, int], above: int, left: int, size: int) -> bool:
    """Return True if all pixels that :func:`finely_sampled` reads are there."""
    rows = above >= _BEFORE and above + _AFTER < shape[0]
    return bool(rows and left >= _BEFORE and left + size + _AFTER <= shape[1])


@lean_kernel
def finely_sampled(
    image: NDArray[np.float32],
    above: int,
    down: float,
    left: int,
    across: float,
    size: int,
    samples: NDArray[np.float32],
) -> None:
    """Sample a row on Lagrange's polynomial through six by six pixels; all of them must be there: :func:`reaches`.

    Parameters
    ----------
    image : numpy.ndarray
        (n, m) float32, C-contiguous.
    above, down : int, float
        Row above the samples, and how far below it they lie, 0 to 1.
    left, across : int, float
        Column before the first sample, and how far beyond it that lies, 0 to 1.
    size : int
        Number of samples.
    samples : numpy.ndarray
        From :func:`scratch`; the first `size` are the samples, the others arbitrary.
    """
    columns, first = image.shape[1], left - _BEFORE
    r0, r1, r2 = (above - 2) * columns + first, (above - 1) * columns + first, above * columns + first
    rows = r0, r1, r2, r2 + columns, r2 + 2 * columns, r2 + 3 * columns
    filter_row(image, rows, _quintic(down), _quintic(across), samples, 0, size)


@lean_kernel
def sampled(
    image: NDArray[np.float32],
    above: int,
    down: float,
    left: int,
    across: float,
    size: int,
    samples: NDArray[np.float32],
) -> None:
    """Sample a row between four pixels; parameters as of :func:`finely_sampled`."""
    first = above * image.shape[1] + left
    upper, near = (np.float32(1 - down), np.float32(down)), (np.float32(1 - across), np.float32(across))
    filter_row(image, (first, first + image.shape[1]), upper, near, samples, 0, size)


@compilable
def _quintic(part: float) -> tuple[np.float32, ...]:
    """Weights of Lagrange's polynomial through six pixels, for a sample that lies `part` beyond the third."""
    a, b, c, d, e, f = part + 2, part + 1, part, part - 1, part - 2, part - 3
    return (
        np.float32(-b * c * d * e * f / 120),
        np.float32(a * c * d * e * f / 24),
        np.float32(-a * b * d * e * f / 12),
        np.float32(a * b * c * e * f / 12),
        np.float32(-a * b * c * d * f / 24),
        np.float32(a * b * c * d * e / 120),
    )
