"""Light on the cores: each samples the blurred planes of the scene where it is while its camera row is read.

For a block of cores, places and weights are computed for all of them before samples are loaded: the former are vector
instructions, the latter wait for memory.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.processing.compiled import kernel

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.simulation.rendering.scan import CoreLight

    Values = NDArray[np.float32]
    Floats = NDArray[np.float64]

BLOCK: Final = 2048
"""Cores of a block; chosen: its nine arrays of 8 kB stay in the second cache."""


@kernel
def sample_cores(
    total: Values,
    of_bundle: Values,
    before: CoreLight,
    after: CoreLight,
    share: float,
    camera_rows: Floats,
    rows_um: Floats,
    cols_um: Floats,
    positions_um: Floats,
    turns: Floats,
    samples: Values,
    first: NDArray[np.int64],
    sizes: NDArray[np.int64],
    per_um: Floats,
) -> None:
    """Write the light on each core of one view, in grey levels.

    Parameters
    ----------
    total, of_bundle : numpy.ndarray
        (cores,) output: all light, and the part that arises in the bundle.
    before, after : CoreLight
        Of two jitters of the line.
    share : float
        Of the way from the one jitter to the other, 0 to 1.
    camera_rows : numpy.ndarray
        (cores,) camera row of each core.
    rows_um, cols_um : numpy.ndarray
        (cores,) position of each core about the centre of the bundle.
    positions_um : numpy.ndarray
        (rows, 2) position of the probe at each camera row.
    turns : numpy.ndarray
        (rows, 2) cosine and sine of the probe's angle; (0, 2) without rotation.
    samples : numpy.ndarray
        Windows of all layers, one after the other.
    first, sizes : numpy.ndarray
        (layers,) index of each window's first sample, and its side, a power of two; it is stored with a row and a
        column more, which repeat its first ones.
    per_um : numpy.ndarray
        (layers,) samples per um.
    """
    mixed = np.float32(share)
    last = len(positions_um) - 2
    middle = len(positions_um) // 2
    scratch = np.empty((7, BLOCK), np.float32)
    y_um, x_um, down, right = scratch[0], scratch[1], scratch[2], scratch[3]
    dy, dx, weight = scratch[4], scratch[5], scratch[6]
    place = np.empty(BLOCK, np.int32)
    for begin in range(0, len(total), BLOCK):
        count = min(BLOCK, len(total) - begin)
        level = total[begin : begin + count]
        for n in range(count):
            core = begin + n
            of_bundle[core] = before.of_bundle[core] + mixed * (after.of_bundle[core] - before.of_bundle[core])
            level[n] = before.steady[core] + mixed * (after.steady[core] - before.steady[core])
        if not len(sizes):
            continue
        for n in range(count):
            row = camera_rows[begin + n]
            r = min(last, max(0, int(row)))
            f = row - r
            y, x = rows_um[begin + n], cols_um[begin + n]
            down[n], right[n] = 1, 0
            if len(turns):
                c = turns[r, 0] + f * (turns[r + 1, 0] - turns[r, 0])
                s = turns[r, 1] + f * (turns[r + 1, 1] - turns[r, 1])
                y, x = c * y - s * x, s * y + c * x
                down[n], right[n] = c, s
            # From the middle of the frame, where single precision is fine enough.
            y += positions_um[r, 0] - positions_um[middle, 0] + f * (positions_um[r + 1, 0] - positions_um[r, 0])
            x += positions_um[r, 1] - positions_um[middle, 1] + f * (positions_um[r + 1, 1] - positions_um[r, 1])
            y_um[n], x_um[n] = y, x
        for t in range(len(sizes)):
            size = sizes[t]
            per, mask, stride = np.float32(per_um[t]), np.int32(size - 1), np.int32(size + 1)
            top, left = positions_um[middle, 0] * per_um[t], positions_um[middle, 1] * per_um[t]
            i0, j0 = np.int32(np.int64(np.floor(top)) & (size - 1)), np.int32(np.int64(np.floor(left)) & (size - 1))
            y0, x0 = np.float32(top - np.floor(top)), np.float32(left - np.floor(left))
            scale0, scale1 = before.scale[t, begin : begin + count], after.scale[t, begin : begin + count]
            shift0, shift1 = before.shift_um[t, begin : begin + count], after.shift_um[t, begin : begin + count]
            for n in range(count):
                shift = shift0[n] + mixed * (shift1[n] - shift0[n])
                weight[n] = scale0[n] + mixed * (scale1[n] - scale0[n])
                i = (y_um[n] + shift * down[n]) * per + y0
                j = (x_um[n] + shift * right[n]) * per + x0
                fi, fj = np.floor(i), np.floor(j)
                dy[n], dx[n] = i - fi, j - fj
                place[n] = ((np.int32(fi) + i0) & mask) * stride + ((np.int32(fj) + j0) & mask)
            window = samples[first[t] : first[t] + (size + 1) * (size + 1)]
            _interpolate(level, weight, window, window[size + 1 :], place, dy, dx)


@kernel
def _interpolate(
    level: Values, weight: Values, upper: Values, lower: Values, place: NDArray[np.int32], dy: Values, dx: Values
) -> None:
    """Add bilinear samples, their upper and lower rows given as two windows."""
    for n in range(len(level)):
        p = np.uint64(place[n])  # unsigned: no index is tested for being negative
        q = p + np.uint64(1)
        above = upper[p] + dx[n] * (upper[q] - upper[p])
        below = lower[p] + dx[n] * (lower[q] - lower[p])
        level[n] += weight[n] * (above + dy[n] * (below - above))


@kernel
def fade_cores(values: Values, total: Values, of_bundle: Values, left: float, bending: float, bent: Values) -> None:
    """Write the grey level of each core after bleaching and bending of the bundle.

    Parameters
    ----------
    values : numpy.ndarray
        (cores,) output.
    total, of_bundle : numpy.ndarray
        (cores,) as of :func:`sample_cores`; the bundle's own light does not bleach.
    left : float
        Part of the specimen's fluorescence that is left.
    bending : float
        Part of its largest change that the cores' transmission has.
    bent : numpy.ndarray
        (cores,) largest relative change of the transmission; empty where the bundle does not bend.
    """
    kept, change = np.float32(left), np.float32(bending)
    for n in range(len(values)):
        values[n] = (total[n] - of_bundle[n]) * kept + of_bundle[n]
    for n in range(len(bent)):
        values[n] *= np.float32(1) + change * bent[n]
