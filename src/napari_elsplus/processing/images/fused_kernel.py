"""Fused sectioning: raw frames to LS, residual and ELS+ in one pass, as a compiled kernel.

Eight rows of the grid are finished at a time, so that everything between the raw frame and the images stays in the
first caches: raw rows are converted to float and freed of their background, resampled along the columns and kept until
no row of the grid needs them; then resampled along the rows, and subtracted. Only blocks that the lit disc touches are
computed. The windowed sinc is that of :mod:`napari_elsplus.processing.images.resampling`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.processing.compiled import lean_kernel, prefetch
from napari_elsplus.processing.images.blocks import BLOCK, PHASES, TAPS, interpolation
from napari_elsplus.processing.images.resampling import LOBES

if TYPE_CHECKING:
    from numpy.typing import NDArray

    ViewArrays = tuple[
        NDArray[np.float64], NDArray[np.int64], NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]
    ]

BAND: Final = 8
"""Rows of the grid that are finished together; chosen."""
WIDTH: Final = 1104
"""Elements from row to row of a view's memory, and the largest side of an image; chosen: constant, so that addresses
are, and 69 cache lines, so that successive rows lie in different sets of the first cache."""
LINE: Final = WIDTH + 48
"""Pixels of a converted raw row: a row, its taps, and the margin of :data:`MAX_STRETCH`."""
_MAX_SHARED_PX: Final = 0.0023
"""Largest error of a row's position where rows share weights, pixels; derived: 0.5 % at 0.35 cycles
per pixel."""

_ROWS_AHEAD: Final = 4
"""Rows of the frame that are prefetched; measured: frames that are in no near cache take 346 us without, 256 with 4
rows, 258 with 8 and 262 with 16; frames that are take 248, 251, 253 and 255."""
_CACHE_LINE: Final = 64
"""Bytes."""

_across_one_row = interpolation(1, along_rows=False)
_across_two_rows = interpolation(2, along_rows=False)
_down_one_row = interpolation(1, along_rows=True)
_down_four_rows = interpolation(4, along_rows=True)


@lean_kernel
def section_views(
    raw_confocal: NDArray[np.generic],
    raw_residual: NDArray[np.generic],
    background: NDArray[np.float32],
    confocal: ViewArrays,
    residual: ViewArrays,
    at_whole_pixels: bool,
    spans: NDArray[np.int64],
    blocks: NDArray[np.int64],
    factors: NDArray[np.float32],
    ls: NDArray[np.float32],
    aligned: NDArray[np.float32],
    els: NDArray[np.float32],
) -> None:
    """Fill the images that are wanted; zero beyond the lit disc.

    Parameters
    ----------
    raw_confocal, raw_residual : numpy.ndarray
        (rows, cols) frames of the two views.
    background : numpy.ndarray
        (rows, cols).
    confocal, residual : tuple of numpy.ndarray
        Arrays of the two views, :attr:`View.arrays`.
    at_whole_pixels : bool
        The confocal view is not interpolated.
    spans, blocks : numpy.ndarray
        Of :func:`extents`.
    factors : numpy.ndarray
        (n, n), by which the residual view is multiplied, or (0, 0).
    ls, aligned, els : numpy.ndarray
        The images, (n, n), or (0, 0) where one is not wanted.
    """
    side = len(spans)
    needs_confocal = ls.shape[0] > 0 or els.shape[0] > 0
    needs_residual = aligned.shape[0] > 0 or els.shape[0] > 0
    confocal[1][2] = residual[1][2] = 0
    for row in range(0, side, BAND):
        if needs_confocal:
            if at_whole_pixels:
                _copy_band(raw_confocal, background, confocal, spans, row)
            else:
                _resample_band(raw_confocal, background, confocal, blocks, row)
        if needs_residual:
            _resample_band(raw_residual, background, residual, blocks, row)
        for r in range(min(BAND, side - row)):
            first, last = spans[row + r, 0], spans[row + r, 1]
            for image in (ls, aligned, els):
                if image.shape[0] > 0:
                    image[row + r, :first] = 0
                    image[row + r, last:] = 0
            from_confocal = confocal[4][r * WIDTH + first : r * WIDTH + last]
            from_residual = residual[4][r * WIDTH + first : r * WIDTH + last]
            if needs_residual and factors.shape[0] > 0:
                _multiply(from_residual, factors[row + r, first:last])
            if els.shape[0] > 0:
                _subtract(from_confocal, from_residual, els[row + r, first:last])
            if ls.shape[0] > 0:
                _copy(from_confocal, ls[row + r, first:last])
            if aligned.shape[0] > 0:
                _copy(from_residual, aligned[row + r, first:last])


@lean_kernel
def _multiply(values: NDArray[np.float32], factors: NDArray[np.float32]) -> None:
    for t in range(len(values)):
        values[t] *= factors[t]


@lean_kernel
def _subtract(a: NDArray[np.float32], b: NDArray[np.float32], out: NDArray[np.float32]) -> None:
    for t in range(len(out)):
        out[t] = a[t] - b[t]


@lean_kernel
def _copy(a: NDArray[np.float32], out: NDArray[np.float32]) -> None:
    for t in range(len(out)):
        out[t] = a[t]


@lean_kernel
def _convert(
    raw: NDArray[np.generic],
    background: NDArray[np.float32],
    row: int,
    col: int,
    out: NDArray[np.float32],
) -> None:
    """Write pixels of a raw row from a column on, minus the background; beyond the frame its edge."""
    rows, cols = raw.shape
    count = len(out)
    nearest = min(max(row, 0), rows - 1)
    before = min(max(-col, 0), count)
    after = max(min(cols - col, count), before)
    pixels, dark, seen = (
        raw[nearest, col + before : col + after],
        background[nearest, col + before : col + after],
        out[before:after],
    )
    line = _CACHE_LINE // raw.itemsize
    for c in range(col + before, col + after + line - 1, line):
        prefetch(raw, nearest + _ROWS_AHEAD, c)
    for t in range(len(seen)):
        seen[t] = np.float32(pixels[t]) - dark[t]
    if before > 0:
        out[:before] = np.float32(raw[nearest, 0]) - background[nearest, 0]
    if after < count:
        out[after:] = np.float32(raw[nearest, cols - 1]) - background[nearest, cols - 1]


@lean_kernel
def _copy_band(
    raw: NDArray[np.generic],
    background: NDArray[np.float32],
    view: ViewArrays,
    spans: NDArray[np.int64],
    row: int,
) -> None:
    """Write a band of a view at whole pixels."""
    affine, _, _, _, memory = view
    top, left = int(np.rint(affine[0])), int(np.rint(affine[3]))
    for r in range(min(BAND, len(spans) - row)):
        first, last = spans[row + r, 0], spans[row + r, 1]
        out = memory[r * WIDTH + first : r * WIDTH + last]
        _convert(raw, background, top + row + r, left + first, out)


@lean_kernel
def _resample_band(
    raw: NDArray[np.generic],
    background: NDArray[np.float32],
    view: ViewArrays,
    blocks: NDArray[np.int64],
    row: int,
) -> None:
    """Write a band of a view, resampled."""
    affine, sizes, _, weights, memory = view
    row_0, per_row, per_col = affine[0], affine[1], affine[2]
    kept = WIDTH * BAND
    _resample_along_columns(raw, background, view, blocks, row)
    top = sizes[1]
    slope = np.float32(per_col)
    shared = 4 if abs(per_row - 1) * 1.5 <= _MAX_SHARED_PX else 1
    for q in range(len(blocks)):
        if row + BAND <= blocks[q, 0] or row >= blocks[q, 1]:
            continue
        for group in range(0, BAND, shared):
            at = row_0 + per_row * (row + group) + 0.5 * (per_row - 1) * (shared - 1) + per_col * (q * BLOCK)
            pixel, phase, beyond = _taps_at(at, per_col)
            first = kept + WIDTH * (pixel - top) + q * BLOCK
            to = WIDTH * group + q * BLOCK
            if shared == 1:
                _down_one_row(memory, first, WIDTH, weights, phase, beyond, slope, memory, to, WIDTH)
            else:
                _down_four_rows(memory, first, WIDTH, weights, phase, beyond, slope, memory, to, WIDTH)


@lean_kernel
def _resample_along_columns(
    raw: NDArray[np.generic],
    background: NDArray[np.float32],
    view: ViewArrays,
    blocks: NDArray[np.int64],
    row: int,
) -> None:
    """Resample the rows of the frame that a band needs along the columns, as far as it was not done for others."""
    affine, sizes, weights, _, memory = view
    row_0, per_row, per_col, col_0, shear, per_col_across = affine
    most, top, made = sizes
    kept = WIDTH * BAND
    lines = WIDTH * (BAND + most)
    lowest = int(np.floor(row_0 + per_row * row + min(0.0, per_col * WIDTH))) - LOBES
    highest = int(np.floor(row_0 + per_row * (row + BAND) + max(0.0, per_col * WIDTH))) + LOBES + 2
    if made == 0:
        top = lowest
    elif highest + 1 - top > most:
        moved = lowest - top
        for k in range(WIDTH * (made - moved)):
            memory[kept + k] = memory[kept + WIDTH * moved + k]
        top, made = lowest, made - moved
    slope = np.float32(per_col_across - 1)
    in_pairs = abs(shear) * 0.5 <= _MAX_SHARED_PX
    while top + made < highest:
        y = top + made
        on_grid, lean = (y - row_0) / per_row, per_col * BLOCK / per_row
        begin, end = 0, len(blocks)
        while begin < end and not _near(blocks[begin], on_grid - lean * begin):
            begin += 1
        while end > begin and not _near(blocks[end - 1], on_grid - lean * (end - 1)):
            end -= 1
        at_0 = col_0 + shear * (y + 0.5)
        left = int(np.floor(at_0 + per_col_across * begin * BLOCK)) - LOBES
        right = min(int(at_0 + per_col_across * end * BLOCK) + LOBES + 3, left + LINE)
        if end > begin:
            for r in range(2):
                line = lines + r * LINE
                _convert(raw, background, y + r, left, memory[line : line + right - left])
        for q in range(begin, end):
            at = at_0 + per_col_across * (q * BLOCK)
            to = kept + WIDTH * made + q * BLOCK
            if in_pairs:
                pixel, phase, beyond = _taps_at(at, per_col_across - 1)
                _across_two_rows(memory, lines + pixel - left, LINE, weights, phase, beyond, slope, memory, to, WIDTH)
            else:
                for r in range(2):
                    pixel, phase, beyond = _taps_at(at + shear * (r - 0.5), per_col_across - 1)
                    first = lines + r * LINE + pixel - left
                    _across_one_row(memory, first, LINE, weights, phase, beyond, slope, memory, to + r * WIDTH, WIDTH)
        made += 2
    sizes[1], sizes[2] = top, made


@lean_kernel
def _near(extent: NDArray[np.int64], row: float) -> bool:
    """Return True if a row is within the taps and the band of a row of an extent."""
    return bool(extent[0] - 2 * BAND < row < extent[1] + 2 * BAND)


@lean_kernel
def _taps_at(at: float, slope: float) -> tuple[int, int, np.float32]:
    """Return the first tap of a block, the element of its weights, and the first pixel's distance from their fraction.

    Parameters
    ----------
    at : float
        Position of the block's first pixel.
    slope : float
        Change of the fraction from pixel to pixel.
    """
    middle = at + slope * 0.5 * (BLOCK - 1)
    whole = np.floor(middle)
    phase = np.rint((middle - whole) * PHASES)
    return int(whole) - LOBES + 1, int(phase) * 3 * TAPS, np.float32(at - whole - phase / PHASES)
