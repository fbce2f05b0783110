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

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.motion.rolling_shutter import Warp

_BEFORE: Final = 2
_AFTER: Final = 3
"""Pixels of the polynomial before the one that a sample follows, and after it."""
_WHOLE_PX: Final = 8
"""Numbers in a vector: loops over a multiple of it have no remainder, for which pixels are added one by one."""


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
def bilinear(
    image: NDArray[np.float32], above: int, down: float, left: int, across: float, size: int
) -> tuple[tuple[NDArray[np.float32], ...], tuple[np.float32, ...]]:
    """Return the four runs of pixels between which a row of samples lies, and their weights.

    The runs are the upper one, that right of it, the lower one, and that right of it.

    Parameters
    ----------
    image : numpy.ndarray
        (n, n) float32.
    above, down : int, float
        Row above the samples, and how far below it they lie, 0 to 1.
    left, across : int, float
        Column before the first sample, and how far beyond it that lies, 0 to 1.
    size : int
        Number of samples.
    """
    end, up, near = left + size, 1 - down, 1 - across
    upper, lower = image[above], image[above + 1]
    return (
        (upper[left:end], upper[left + 1 : end + 1], lower[left:end], lower[left + 1 : end + 1]),
        (np.float32(up * near), np.float32(up * across), np.float32(down * near), np.float32(down * across)),
    )


@lean_kernel
def between(corners: tuple[NDArray[np.float32], ...], weights: tuple[np.float32, ...], k: int) -> np.float32:
    """Return sample k of such a row.

    Parameters
    ----------
    corners, weights : tuple
        From :func:`bilinear`.
    k : int
        Index of the column.
    """
    sample: np.float32 = (
        weights[0] * corners[0][k]
        + weights[1] * corners[1][k]
        + weights[2] * corners[2][k]
        + weights[3] * corners[3][k]
    )
    return sample


@lean_kernel
def reaches(shape: tuple[int, int], above: int, left: int, size: int) -> bool:
    """Return True if all pixels that :func:`finely_sampled` reads are there."""
    rows = above >= _BEFORE and above + _AFTER < shape[0]
    return bool(rows and left >= _BEFORE and left + size + _AFTER <= shape[1])


@lean_kernel
def finely_sampled(
    image: NDArray[np.float32], above: int, down: float, left: int, across: float, size: int, work: NDArray[np.float32]
) -> tuple[tuple[NDArray[np.float32], ...], tuple[np.float32, ...]]:
    """Sample a row on Lagrange's polynomial through six by six pixels; all of them must be there: :func:`reaches`.

    Parameters
    ----------
    image : numpy.ndarray
        (n, m) float32.
    above, down : int, float
        Row above the samples, and how far below it they lie, 0 to 1.
    left, across : int, float
        Column before the first sample, and how far beyond it that lies, 0 to 1.
    size : int
        Number of samples.
    work : numpy.ndarray
        (2, m) float32 scratch; the samples are in its first row.

    Returns
    -------
    corners, weights : tuple
        What :func:`between` gives them by, as it does those between four pixels.
    """
    wide = min(-(-size // _WHOLE_PX) * _WHOLE_PX, image.shape[1] - left - _AFTER)
    begin, end = left - _BEFORE, min(left - _BEFORE + wide + _WHOLE_PX, image.shape[1])
    v0, v1, v2, v3, v4, v5 = _quintic(down)
    r0, r1, r2 = image[above - 2, begin:end], image[above - 1, begin:end], image[above, begin:end]
    r3, r4, r5 = image[above + 1, begin:end], image[above + 2, begin:end], image[above + 3, begin:end]
    columns = work[1, : end - begin]
    for k in range(end - begin):
        columns[k] = v0 * r0[k] + v1 * r1[k] + v2 * r2[k] + v3 * r3[k] + v4 * r4[k] + v5 * r5[k]
    w0, w1, w2, w3, w4, w5 = _quintic(across)
    c0, c1, c2 = columns[:wide], columns[1 : wide + 1], columns[2 : wide + 2]
    c3, c4, c5 = columns[3 : wide + 3], columns[4 : wide + 4], columns[5 : wide + 5]
    samples = work[0, :wide]
    for k in range(wide):
        samples[k] = w0 * c0[k] + w1 * c1[k] + w2 * c2[k] + w3 * c3[k] + w4 * c4[k] + w5 * c5[k]
    nothing = np.float32(0)
    return (samples, samples, samples, samples), (np.float32(1), nothing, nothing, nothing)


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
