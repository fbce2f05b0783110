"""From core brightness to camera pixels: spots, background, shot and read noise, eight bits."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from napari_elsplus.processing.compiled import kernel

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.simulation.model.bundle import Bundle

SPOTS_PER_PIXEL = 3
"""Cores that light a pixel; the fourth nearest lies more than a pitch away, 3.8 standard deviations of a spot."""
GHOST_PART = 16
"""Part of the frame's width by which a ghost is displaced; chosen: within the same view, and far from its own light."""
GAIN_UNIT = 2**-14
"""Of the pixels' gains; chosen: two bytes reach to a gain of 4, and are off by a thirtieth of a thousandth."""
_REACH_PITCHES = 1.0
"""Distance from the outermost cores, in core pitches, to which pixels are lit."""


class Spots(NamedTuple):
    """Cores that light each pixel of one view.

    ``cores`` and ``weights`` are (3, pixels), the pixels row after row; row r has the pixels ``first[r]`` to
    ``first[r + 1] - 1``, which begin at column ``column[r]``.
    """

    first: NDArray[np.int64]
    column: NDArray[np.int64]
    cores: NDArray[np.uint16]
    weights: NDArray[np.uint8]
    scale: float


def spread_spots(
    rows_px: NDArray[np.float64],
    cols_px: NDArray[np.float64],
    frame_shape: tuple[int, int],
    bundle: Bundle,
    um_per_px: float,
) -> Spots:
    """Return the cores that light each pixel of a view.

    Parameters
    ----------
    rows_px, cols_px : numpy.ndarray
        (cores,) position of the cores on the sensor.
    frame_shape : tuple of int
        Rows and columns of the frame.
    bundle : Bundle
        Its pitch and core size determine the spots.
    um_per_px : float
        Micrometres per pixel.

    Returns
    -------
    Spots
        Weights average 1 over the lit disc.
    """
    pitch_px = bundle.core_pitch_um / um_per_px
    reach = _REACH_PITCHES * pitch_px
    centre = np.array([rows_px.max() + rows_px.min(), cols_px.max() + cols_px.min()]) / 2
    radius = np.hypot(rows_px - centre[0], cols_px - centre[1]).max() + reach
    rows = np.arange(frame_shape[0])
    half = np.sqrt(np.maximum(radius**2 - (rows - centre[0]) ** 2, 0))
    left = np.clip(np.ceil(centre[1] - half), 0, frame_shape[1]).astype(np.int64)
    right = np.clip(np.floor(centre[1] + half) + 1, left, frame_shape[1]).astype(np.int64)
    right = np.where(half > 0, right, left)
    first = np.concatenate([[0], np.cumsum(right - left)])
    pixel_rows = np.repeat(rows, right - left)
    pixel_cols = np.arange(first[-1]) - np.repeat(first[:-1] - left, right - left)
    tree = cKDTree(np.stack([rows_px, cols_px], 1))
    # by this thread alone: workers of the tree outlive Ctrl-C, and then crash on what was released
    away, cores = tree.query(np.stack([pixel_rows, pixel_cols], 1), k=SPOTS_PER_PIXEL)
    weights = np.exp(-0.5 * (away / (bundle.core_sigma * pitch_px)) ** 2)
    lit = np.hypot(pixel_rows - centre[0], pixel_cols - centre[1]) < radius - 2 * reach
    scale = 1 / weights[lit].sum(1).mean()
    by_place = np.ascontiguousarray(cores.T, np.uint16), np.ascontiguousarray(np.round(255 * weights).T, np.uint8)
    return Spots(first, left, *by_place, scale / 255)


@kernel
def expose(
    out: NDArray[np.uint8],
    left: Spots,
    left_values: NDArray[np.float32],
    right: Spots,
    right_values: NDArray[np.float32],
    row_signal: NDArray[np.float32],
    row_power: NDArray[np.float32] | None,
    row_black_dn: NDArray[np.float32] | None,
    pixel_gain: NDArray[np.uint16] | None,
    hot_first: NDArray[np.int64] | None,
    hot_column: NDArray[np.int64] | None,
    hot_dn: NDArray[np.float32] | None,
    ghost: float,
    black_dn: float,
    electrons_per_dn: float,
    read_noise_e: float,
    key: int,
) -> None:
    """Write a frame: grey levels of the cores spread over pixels, black level, noise, 8 bit.

    Noise is a sum of four bytes of a hash of pixel and key: Gaussian within +-3.4 standard deviations, the same for the
    same key, and without state.

    Parameters
    ----------
    out : numpy.ndarray
        (rows, cols) output.
    left, right : Spots
        Of the confocal and of the residual view.
    left_values, right_values : numpy.ndarray
        (cores,) grey levels of each, times the scale of its spots.
    row_signal : numpy.ndarray
        (2, 2 cols) scratch, zero at the first call.
    row_power, row_black_dn : numpy.ndarray or None
        (rows,) factor on the light while each row is exposed, and grey levels added to the row; None of the ideal
        instrument, as the next four.
    pixel_gain : numpy.ndarray or None
        (rows, cols) factor on each pixel's signal, in units of `GAIN_UNIT`.
    hot_first, hot_column, hot_dn : numpy.ndarray or None
        Hot pixels: fields of `Readout`.
    ghost : float
        Share of the light that a reflection displays again, displaced along the row by a sixteenth of the frame.
    black_dn, electrons_per_dn, read_noise_e : float
        Black level, grey levels; gain, electrons per grey level; read noise, electrons.
    key : int
        64-bit key of the noise.
    """
    rows, cols = out.shape
    shot = np.float32(1 / electrons_per_dn)
    read = np.float32((read_noise_e / electrons_per_dn) ** 2)
    black = np.float32(black_dn + 0.5)
    norm = np.float32(1 / 147.80)  # standard deviation of a sum of four uniform bytes
    key_a = np.uint32(key & 0xFFFFFFFF)
    key_b = np.uint32((key >> 32) & 0xFFFFFFFF)
    noisy = electrons_per_dn < 1e6
    light, left_of = row_signal[0, cols:], row_signal[0, cols - cols // GHOST_PART :]
    disturbed = row_power is not None and row_black_dn is not None and pixel_gain is not None
    seen = row_signal[1] if disturbed else light
    for r in range(rows):
        for c in range(cols):
            light[c] = 0
            seen[c] = 0
        _spread_row(light, r, left, left_values)
        _spread_row(light, r, right, right_values)
        row_black = black
        if row_power is not None and row_black_dn is not None and pixel_gain is not None:
            row_black += row_black_dn[r]
            power, gain = row_power[r] * np.float32(GAIN_UNIT), pixel_gain[r]
            left_end = left.column[r] + left.first[r + 1] - left.first[r]
            right_end = right.column[r] + right.first[r + 1] - right.first[r]
            begin = min(left.column[r], right.column[r])  # before it there is no light, nor behind the end
            end = min(cols, max(left_end, right_end) + (cols // GHOST_PART if ghost > 0 else 0))
            _disturb(seen[begin:end], light[begin:end], left_of[begin:end], gain[begin:end], power, ghost)
        if hot_first is not None and hot_column is not None and hot_dn is not None:
            for p in range(hot_first[r], hot_first[r + 1]):
                seen[hot_column[p]] += hot_dn[p]
        base, row = np.uint32(r * cols), out[r]
        for c in range(cols):
            signal = seen[c]
            if noisy:
                word = np.uint32((base + np.uint32(c)) ^ key_a)
                word = np.uint32(word * np.uint32(0x7FEB352D))
                word = np.uint32(word ^ (word >> np.uint32(15)))
                word = np.uint32(word + key_b)
                word = np.uint32(word * np.uint32(0x846CA68B))
                word = np.uint32(word ^ (word >> np.uint32(16)))
                total = np.int32(
                    (word & np.uint32(255))
                    + ((word >> np.uint32(8)) & np.uint32(255))
                    + ((word >> np.uint32(16)) & np.uint32(255))
                    + (word >> np.uint32(24))
                )
                signal += np.sqrt(signal * shot + read) * (np.float32(total) - np.float32(510)) * norm
            row[c] = np.uint8(min(np.float32(255), max(np.float32(0), signal + row_black)))


@kernel
def _disturb(
    seen: NDArray[np.float32],
    light: NDArray[np.float32],
    reflected: NDArray[np.float32],
    gain: NDArray[np.uint16],
    power: float,
    ghost: float,
) -> None:
    share, factor = np.float32(ghost), np.float32(power)
    for c in range(len(seen)):
        seen[c] = (light[c] + share * reflected[c]) * (factor * np.float32(gain[c]))


@kernel
def _spread_row(light: NDArray[np.float32], r: int, spots: Spots, values: NDArray[np.float32]) -> None:
    column, first, last = spots.column[r], spots.first[r], spots.first[r + 1]
    row = light[column : column + last - first]
    cores, weights = spots.cores[:, first:last], spots.weights[:, first:last]
    core0, core1, core2 = cores[0], cores[1], cores[2]
    weight0, weight1, weight2 = weights[0], weights[1], weights[2]
    for p in range(last - first):
        row[p] += (
            np.float32(weight0[p]) * values[core0[p]]
            + np.float32(weight1[p]) * values[core1[p]]
            + np.float32(weight2[p]) * values[core2[p]]
        )
