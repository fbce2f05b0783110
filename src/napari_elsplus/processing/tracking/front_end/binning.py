"""The two views of a raw frame, binned onto a coarser grid, subtracted and smoothed in one pass over its memory.

Row by row of the grid, so that everything but the camera's memory and the result stays in the processor's nearest
cache; the memory that comes next is prefetched.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from napari_elsplus.processing.compiled import lean_kernel, prefetch

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Frame = NDArray[Any]
    Image = NDArray[np.float32]
    Matrix = NDArray[np.float64]
    Columns = NDArray[np.int32]
    Pixels = tuple[int, ...]

_EPSILON: Final = 1e-6
_ROWS_AHEAD: Final = 3
"""Rows of the grid whose camera memory is prefetched; measured on frames that are in no cache, which take 77 us with 8
rows (what came early is evicted again), 70 with 2, 101 with 1, and 140 without."""
_CACHE_LINE: Final = 64
_TAPS: Final = 5
_WHOLE_PX: Final = 32
"""Loops over a multiple of it have no remainder, for which pixels are added one by one: four vectors of eight."""
_EVERY_PX: Final = 8
_MARGIN: Final = 2


def scratch(side: int) -> Image:
    """Return what :func:`subtract_views` works in: a smoothed row, and the last rows of the grid with a margin."""
    return np.zeros((1 + _TAPS, side + 2 * _MARGIN + _WHOLE_PX), np.float32)


@lean_kernel
def subtract_views(
    raw: Frame, raw_residual: Frame, confocal: Matrix, residual: Matrix, weights: tuple[float, float], pixels: Pixels,
    first: Columns, last: Columns, scale: Image, offset: Image, work: Image, out: Image,
) -> None:  # fmt: skip
    """Add both views of a frame, binned and weighted; smooth; multiply by `scale` and subtract `offset`.

    Parameters
    ----------
    raw, raw_residual : numpy.ndarray
        (rows, cols) frames that the confocal and the residual view are taken from.
    confocal, residual : numpy.ndarray
        (2, 3): from (row, col, 1), counted in camera pixels from the grid's corner, to (row, col) in the frame. They
        differ little from translations, so that whole-pixel shifts are constant over long runs of columns.
    weights : tuple of float
        Of the two views; a view of weight zero is not read.
    pixels : tuple of int
        0, 1, ...: as many as there are camera pixels per grid pixel in a row; compiled for that number.
    first, last : numpy.ndarray
        (n,) int32: lit columns of each row of the grid.
    scale, offset : numpy.ndarray
        (n, n) float32; the smoothing kernel 1 4 6 4 1, a Gaussian of one pixel, is not normalised.
    work : numpy.ndarray
        From :func:`scratch`.
    out : numpy.ndarray
        (n, n) float32 image; zero outside of the lit columns.
    """
    side = out.shape[0]
    line, ring = work[0], work[1:]
    ring[:] = np.float32(0)
    for i in range(side + 2):
        row = ring[i % _TAPS, _MARGIN : side + _MARGIN]
        row[:] = np.float32(0)
        if i < side and last[i] > first[i]:
            begin, end = int(np.intp(first[i])), int(np.intp(last[i]))  # of one type, for which kernels are compiled
            if weights[0] != 0.0:
                _add_row(raw, confocal, pixels, weights[0], i, begin, end, row)
            if weights[1] != 0.0:
                _add_row(raw_residual, residual, pixels, weights[1], i, begin, end, row)
        if i >= 2:
            _smooth_row(ring, i - 2, first[i - 2], last[i - 2], scale[i - 2], offset[i - 2], line, out[i - 2])


@lean_kernel
def _add_row(
    raw: Frame, matrix: Matrix, pixels: Pixels, weight: float, i: int, begin: int, end: int, into: Image
) -> None:
    """Add a row of a view to the lit columns of a row of the grid."""
    binning = len(pixels)
    half = 0.5 * (binning - 1)
    row = binning * i + half
    # first camera row of the grid's column j: top + tilt * j; first camera column: shift + (growth + binning) * j
    top, tilt = matrix[0, 0] * row + matrix[0, 1] * half + matrix[0, 2] - half, binning * matrix[0, 1]
    shift, growth = matrix[1, 0] * row + matrix[1, 1] * half + matrix[1, 2] - half, binning * (matrix[1, 1] - 1.0)
    ahead = int(top + tilt * begin) + _ROWS_AHEAD * binning
    left, right = int(shift + growth * begin) + binning * begin, int(shift + growth * end) + binning * end
    for r in range(ahead, min(ahead + binning, len(raw))):
        for c in range(left, right + _CACHE_LINE - 1, _CACHE_LINE):
            prefetch(raw, r, c)
    whole_pixels = tilt == 0.0 and growth == 0.0 and top == np.floor(top) and shift == np.floor(shift)
    while begin < end:
        whole, stop = _run(shift, growth, begin, end)
        above, stop = _run(top, tilt, begin, stop)
        left, run = whole + binning * begin, into[begin:stop]
        if whole_pixels:
            _add_squares(raw, above, left, pixels, weight, run)
        else:
            down, across = top + tilt * begin - above, shift + growth * begin - whole
            _add_between(raw, above, left, (down, tilt), (across, growth), pixels, weight, run)
        begin = stop


@lean_kernel
def _run(at: float, slope: float, begin: int, end: int) -> tuple[int, int]:
    """Whole part of `at` + `slope` * k at k = `begin`, and the k before `end` at which it changes."""
    whole = int(np.floor(at + slope * begin + _EPSILON))
    if slope == 0.0:
        return whole, end
    edge = whole + 1 if slope > 0 else whole
    return whole, min(end, max(begin + 1, int(np.ceil((edge - at) / slope))))


@lean_kernel
def _add_squares(raw: Frame, top: int, left: int, pixels: Pixels, weight: float, into: Image) -> None:
    """Add the sums of squares of camera pixels that lie squarely on the grid, two rows at a time."""
    binning, w = len(pixels), np.float32(weight)
    size = len(into)
    for r in range(0, binning, 2):
        paired = r + 1 < binning
        upper, lower = raw[top + r, left : left + binning * size], raw[top + r + paired, left : left + binning * size]
        v = w if paired else np.float32(0)
        for k in range(size):
            into[k] += w * _sum(upper, k, pixels) + v * _sum(lower, k, pixels)


@lean_kernel
def _add_between(
    raw: Frame, above: int, left: int, down: tuple[float, float], across: tuple[float, float], pixels: Pixels,
    weight: float, into: Image,
) -> None:  # fmt: skip
    """Add the sums of squares that lie between camera pixels: `down` and `across` are fractions and their slopes."""
    binning, one, w = len(pixels), np.float32(1), np.float32(weight)
    d, tilt, f, growth = np.float32(down[0]), np.float32(down[1]), np.float32(across[0]), np.float32(across[1])
    size = len(into)
    right = left + binning * size + 1
    upper, lower = raw[above, left:right], raw[above + binning, left:right]
    second, middle = raw[above + min(1, binning - 1), left:right], np.float32(min(1, binning - 1))
    for k in range(size):
        column = np.float32(np.int32(k))  # of 32 bits: the processor has no vectors for the conversion of 64
        part, aside = d + tilt * column, f + growth * column
        edges = (one - part) * _sum_aside(upper, k, aside, pixels) + part * _sum_aside(lower, k, aside, pixels)
        into[k] += w * (edges + middle * _sum_aside(second, k, aside, pixels))
    for r in range(2, binning):
        more = raw[above + r, left:right]
        for k in range(size):
            into[k] += w * _sum_aside(more, k, f + growth * np.float32(np.int32(k)), pixels)


@lean_kernel
def _sum(line: Frame, k: int, pixels: Pixels) -> np.float32:
    """Return the sum of the camera pixels of a row that column k of the grid covers."""
    binning, total = len(pixels), np.float32(line[len(pixels) * k])
    for b in range(1, binning):
        total += np.float32(line[binning * k + b])
    return total


@lean_kernel
def _sum_aside(line: Frame, k: int, aside: np.float32, pixels: Pixels) -> np.float32:
    """Return the sum of as many camera pixels, a fraction of one aside."""
    binning = len(pixels)
    step: np.float32 = np.float32(line[binning * k + binning]) - np.float32(line[binning * k])
    return _sum(line, k, pixels) + aside * step


@lean_kernel
def _smooth_row(
    ring: Image, i: int, begin: int, end: int, scale: Image, offset: Image, line: Image, out: Image
) -> None:
    """Smooth one row; `ring` holds it and two rows on either side, with a margin of two columns."""
    four, six, size = np.float32(4), np.float32(6), end - begin
    if size > 0:
        reach = _whole(size + 2 * _MARGIN)
        a, b, c, d, e = (
            ring[(i + 3) % _TAPS, begin : begin + reach],
            ring[(i + 4) % _TAPS, begin : begin + reach],
            ring[i % _TAPS, begin : begin + reach],
            ring[(i + 1) % _TAPS, begin : begin + reach],
            ring[(i + 2) % _TAPS, begin : begin + reach],
        )
        for k in range(reach):
            line[k] = a[k] + e[k] + four * (b[k] + d[k]) + six * c[k]
        wide = min(_whole(size), len(out) - begin)
        l0, l1, l2, l3, l4 = line[:wide], line[1 : wide + 1], line[2 : wide + 2], line[3 : wide + 3], line[4 : wide + 4]
        factor, less, result = scale[begin : begin + wide], offset[begin : begin + wide], out[begin : begin + wide]
        for k in range(wide):
            result[k] = factor[k] * (l0[k] + l4[k] + four * (l1[k] + l3[k]) + six * l2[k]) - less[k]
    out[:begin] = np.float32(0)
    out[end:] = np.float32(0)


@lean_kernel
def _whole(pixels: int) -> int:
    """Return the least multiple of :data:`_WHOLE_PX` that is at least so many pixels."""
    return -(-pixels // _WHOLE_PX) * _WHOLE_PX


@lean_kernel
def is_blank(raw: Frame, top: int, left: int, reach: int, limit: float) -> bool:
    """Return True if most of a square part of a frame is at a limit, or all at one level; every eighth pixel counts.

    Parameters
    ----------
    raw : numpy.ndarray
        (rows, cols) raw frame.
    top, left : int
        First row and column of the part.
    reach : int
        Its rows and columns.
    limit : float
        Grey level at which the camera saturates.
    """
    full, alike, seen = 0, 0, 0
    for r in range(top, top + reach, _EVERY_PX):
        for c in range(left, left + reach, _EVERY_PX):
            full += raw[r, c] == limit
            alike += raw[r, c] == raw[top, left]
            seen += 1
    return 2 * full > seen or alike == seen
