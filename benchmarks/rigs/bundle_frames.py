"""Frames of a photographed bundle over a moving target: the photograph's own cores, each lit by what it would see."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from napari_elsplus.processing.calibration.bundle.location import locate_bundle
from napari_elsplus.processing.images.cores import core_pitch_px, find_cores

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Image = NDArray[np.float32]

PERIODS: Final = (3.2, 2.6, 2.2, 1.9, 1.6, 1.4, 1.2, 1.0)
"""Line pairs of the target, core pitches."""
_BARS: Final = 4.5
_LENGTH: Final = 15.0
"""Core pitches."""
_DARK: Final = 0.1
"""Light behind a bar, as a fraction of that beside it."""
_MODE_PITCHES: Final = 0.28
"""Standard deviation of a core's mode."""
_ELECTRONS_PER_DN: Final = 20.0
_READ_NOISE_DN: Final = 0.7


class BundleFrames(NamedTuple):
    """Frames (T, rows, cols) uint8, the evenly lit photograph, true displacements (T, 2) px, and the core pitch, px."""

    frames: NDArray[np.uint8]
    flat: Image
    displacements_px: NDArray[np.float64]
    pitch_px: float


def bundle_frames(flat: Image, count: int, reach_px: float, seed: int = 0) -> BundleFrames:
    """Return frames of dark bars on a bright ground through a photographed bundle.

    Parameters
    ----------
    flat : numpy.ndarray
        (rows, cols) photograph of the evenly lit bundle.
    count : int
        Number of frames.
    reach_px : float
        Largest displacement along either axis; that of the first frame is 0.
    seed : int
        Seed of displacements and noise.
    """
    disc = locate_bundle(flat)
    side = int(min(disc.diameter_px, *flat.shape))
    top, left = (max(int(centre - side / 2), 0) for centre in disc.centre)
    crop = np.ascontiguousarray(flat[top : top + side, left : left + side])
    side = min(crop.shape)
    rows, cols = np.mgrid[:side, :side]
    inside = np.hypot(rows + top - disc.centre[0], cols + left - disc.centre[1]) < disc.diameter_px / 2
    cores = find_cores(crop[:side, :side], inside)
    pitch_px = core_pitch_px(crop[:side, :side], inside)
    cores = np.add(cores, (top, left))
    pixels = np.indices(flat.shape).reshape(2, -1).T
    nearest = cKDTree(cores).query(pixels)[1].reshape(flat.shape)
    random = np.random.default_rng(seed)
    moves = random.uniform(-reach_px, reach_px, (count, 2))
    moves[0] = 0
    frames = []
    for move in moves:
        light = _through_modes((cores + move - disc.centre) / pitch_px)
        seen = random.poisson(np.maximum(flat * light[nearest], 0) * _ELECTRONS_PER_DN) / _ELECTRONS_PER_DN
        frames.append(np.clip(np.rint(seen + random.normal(0, _READ_NOISE_DN, flat.shape)), 0, 255).astype(np.uint8))
    return BundleFrames(np.stack(frames), flat, moves, pitch_px)


def _through_modes(places: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the light of the target through modes at places (m, 2), core pitches from the bundle's centre."""
    steps = np.linspace(-2, 2, 9)
    weights = np.exp(-0.5 * steps**2) / np.exp(-0.5 * steps**2).sum()
    total = np.zeros(len(places))
    for down, one in zip(steps * _MODE_PITCHES, weights, strict=True):
        for across, other in zip(steps * _MODE_PITCHES, weights, strict=True):
            total += one * other * _target(places[:, 0] + down, places[:, 1] + across)
    return total


def _target(row: NDArray[np.float64], col: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the light of the target at places in core pitches: bars both ways, of a period after the other."""
    light = np.ones(len(row))
    for index, period in enumerate(PERIODS):
        top, left = -42.0 + 24.0 * (index % 4), -44.0 + 48.0 * (index // 4)
        for along, across in ((row - top, col - left), (col - left - 24.0, row - top)):
            bars = (along > 0) & (along < _LENGTH) & (across > 0) & (across < _BARS * period)
            light[bars & (across / period % 1 < 0.5)] = _DARK
    return light
