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

_EPSILON: Final = 1e-6
_ROWS_AHEAD: Final = 3
"""Rows of the grid whose camera memory is prefetched; measured on frames that are in no cache, which take 77 us with 8
rows (what came early is evicted again), 70 with 2, 101 with 1, and 140 without."""
_CACHE_LINE: Final = 64
_TAPS: Final = 5
_EVERY_PX: Final = 8
_MARGIN: Final = 2


def scratch(side: int, frame_width: int) -> Image:
    """Return what :func:`subtract_views` works in: rows of sums, and the last rows of the grid with a margin."""
    return np.zeros((3 + _TAPS, max(side + 4, frame_width + 2)), np.float32)


@lean_kernel
def subtract_views(
    raw: Frame, raw_residual: Frame, confocal: Matrix, residual: Matrix, weights: tuple[float, float], binning: int,
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
    binning : int
        Camera pixels per grid pixel.
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
    lines, ring = work[:3], work[3:]
    ring[:] = np.float32(0)
    for i in range(side + 2):
        row = ring[i % _TAPS, _MARGIN : side + _MARGIN]
        row[:] = np.float32(0)
        if i < side and last[i] > first[i]:
            begin, end = int(np.intp(first[i])), int(np.intp(last[i]))  # of one type, for which kernels are compiled
            if weights[0] != 0.0:
                _add_row(raw, confocal, binning, weights[0], i, begin, end, lines, row)
            if weights[1] != 0.0:
                _add_row(raw_residual, residual, binning, weights[1], i, begin, end, lines, row)
        if i >= 2:
            _smooth_row(ring, i - 2, first[i - 2], last[i - 2], scale[i - 2], offset[i - 2], lines[0], out[i - 2])


@lean_kernel
def _add_row(
    raw: Frame, matrix: Matrix, binning: int, weight: float, i: int, begin: int, end: int, lines: Image, into: Image
) -> None:
    """Add a row of a view to a row of the grid."""
    half = 0.5 * (binning - 1)
    slope = matrix[0, 1] / matrix[1, 1]  # rows per column, along the view's own columns
    growth = binning * (matrix[1, 1] - 1.0)
    row = binning * i + half
    # leftmost camera column of the grid's column j: shift + growth * j + binning * j
    shift = matrix[1, 0] * row + matrix[1, 1] * half + matrix[1, 2] - half
    left = int(np.floor(shift + growth * begin + _EPSILON)) + binning * begin
    right = int(np.floor(shift + growth * (end - 1) + _EPSILON)) + binning * end
    top = matrix[0, 0] * row + matrix[0, 2] - half + slope * (left - matrix[1, 0] * row - matrix[1, 2])
    height, width = raw.shape
    width = min(right + 1, width) - left
    ahead = int(top) + _ROWS_AHEAD * binning
    for r in range(ahead, min(ahead + binning, height)):
        for c in range(left, left + width + _CACHE_LINE - 1, _CACHE_LINE):
            prefetch(raw, r, c)
    if binning == 2 and slope == 0.0 and growth == 0.0 and top == np.floor(top) and shift == np.floor(shift):
        _add_squares(raw, int(top), left, weight, into[begin:end])
        return
    sums = lines[0]
    sums[width] = sums[width + 1] = np.float32(0)
    a = int(np.intp(0))  # a variable, as later
    while a < width:
        above, b = _run(top, slope, a, width)
        _sum_rows(raw, above, max(top + slope * a - above, 0.0), slope, left, a, b, binning, sums)
        a = b
    a = begin
    while a < end:
        whole, b = _run(shift, growth, a, end)
        across = max(shift + growth * a - whole, 0.0)
        _sum_columns(sums[binning * a + whole - left :], across, growth, binning, weight, lines[1:], into[a:b])
        a = b


@lean_kernel
def _run(at: float, slope: float, begin: int, end: int) -> tuple[int, int]:
    """Whole part of `at` + `slope` * k at k = `begin`, and the k before `end` at which it changes."""
    whole = int(np.floor(at + slope * begin + _EPSILON))
    if slope == 0.0:
        return whole, end
    edge = whole + 1 if slope > 0 else whole
    return whole, min(end, max(begin + 1, int(np.ceil((edge - at) / slope))))


@lean_kernel
def _add_squares(raw: Frame, top: int, left: int, weight: float, into: Image) -> None:
    """Add the sums of two by two camera pixels that lie squarely on the grid."""
    size, w = len(into), np.float32(weight)
    upper, lower = raw[top, left : left + 2 * size], raw[top + 1, left : left + 2 * size]
    for k in range(size):
        above = np.float32(upper[2 * k]) + np.float32(upper[2 * k + 1])
        into[k] += w * (above + (np.float32(lower[2 * k]) + np.float32(lower[2 * k + 1])))


@lean_kernel
def _sum_rows(
    raw: Frame, above: int, down: float, slope: float, left: int, begin: int, end: int, binning: int, sums: Image
) -> None:
    """Sum `binning` rows from `down` below row `above`, in a run of columns."""
    one, d, g = np.float32(1), np.float32(down), np.float32(slope)
    upper, lower = raw[above, left + begin : left + end], raw[above + binning, left + begin : left + end]
    second = raw[above + min(1, binning - 1), left + begin : left + end]
    into = sums[begin:end]
    if binning == 1:
        for k in range(end - begin):
            f = d + g * np.float32(k)
            into[k] = (one - f) * np.float32(upper[k]) + f * np.float32(lower[k])
        return
    for k in range(end - begin):
        f = d + g * np.float32(k)
        into[k] = (one - f) * np.float32(upper[k]) + np.float32(second[k]) + f * np.float32(lower[k])
    for r in range(2, binning):
        more = raw[above + r, left + begin : left + end]
        for k in range(end - begin):
            into[k] += np.float32(more[k])


@lean_kernel
def _sum_columns(
    sums: Image, across: float, growth: float, binning: int, weight: float, lines: Image, into: Image
) -> None:
    """Add `binning` columns from `across` beyond the first, for a run of the grid's columns."""
    one, a, g, w = np.float32(1), np.float32(across), np.float32(growth), np.float32(weight)
    size = len(into)
    edge, between = lines[0, : size + 1], lines[1, :size]
    if binning == 2:
        for k in range(size):
            edge[k], between[k] = sums[2 * k], sums[2 * k + 1]
    else:
        for k in range(size):
            edge[k] = sums[binning * k]
            total = np.float32(0)
            for b in range(1, binning):
                total += sums[binning * k + b]
            between[k] = total
    edge[size] = sums[binning * size]
    beyond = edge[1:]
    for k in range(size):
        f = a + g * np.float32(k)
        into[k] += w * ((one - f) * edge[k] + between[k] + f * beyond[k])


@lean_kernel
def _smooth_row(
    ring: Image, i: int, begin: int, end: int, scale: Image, offset: Image, line: Image, out: Image
) -> None:
    """Smooth one row; `ring` holds it and two rows on either side, with a margin of two columns."""
    four, six = np.float32(4), np.float32(6)
    out[:begin] = np.float32(0)
    out[end:] = np.float32(0)
    size = end - begin
    if size <= 0:
        return
    reach = size + _TAPS - 1
    a, b, c, d, e = (
        ring[(i + 3) % _TAPS, begin : begin + reach],
        ring[(i + 4) % _TAPS, begin : begin + reach],
        ring[i % _TAPS, begin : begin + reach],
        ring[(i + 1) % _TAPS, begin : begin + reach],
        ring[(i + 2) % _TAPS, begin : begin + reach],
    )
    for k in range(reach):
        line[k] = a[k] + e[k] + four * (b[k] + d[k]) + six * c[k]
    l0, l1, l2, l3, l4 = line[:size], line[1 : size + 1], line[2 : size + 2], line[3 : size + 3], line[4 : size + 4]
    factor, less, result = scale[begin:end], offset[begin:end], out[begin:end]
    for k in range(size):
        result[k] = factor[k] * (l0[k] + l4[k] + four * (l1[k] + l3[k]) + six * l2[k]) - less[k]


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
