"""Pyramid of a tracking image."""

from __future__ import annotations

import cv2
import numpy as np

from napari_elsplus.processing.tracking.front_end.grid import Grid, lit_pixels
from napari_elsplus.processing.tracking.motion.rolling_shutter import RollingShutter
from napari_elsplus.processing.tracking.registration.pyramid import (
    HIGH_PASS_PX,
    HIGH_PASSED,
    Levels,
    Pyramid,
    fill_levels,
    high_pass,
)

GRID = Grid(236, 1, (0, 0), (117.3, 118.1), 232.0, RollingShutter(300.0))


def _filled(image: np.ndarray) -> tuple[Levels, Pyramid]:
    frame, pyramid = Levels.of(GRID.side), Pyramid.of(GRID, 1.0)
    frame.images[0][:] = image
    fill_levels(frame, pyramid)
    return frame, pyramid


def _halved(image: np.ndarray) -> np.ndarray:
    return image.reshape(len(image) // 2, 2, -1, 2).mean(axis=(1, 3))


def test_what_is_smooth_within_the_disc_is_subtracted() -> None:
    """Against OpenCV's Gaussian and bilinear interpolation of the same part of the image."""
    lit = lit_pixels(*GRID.spans(1.0)).astype(np.float32)
    image = lit * np.random.default_rng(0).normal(100, 30, lit.shape).astype(np.float32)
    frame, pyramid = _filled(image)
    levels = frame.images

    half = _halved(image)
    inside = lit_pixels(*GRID.binned(4).spans(1.0)).astype(np.float32)
    sigma, constant = HIGH_PASS_PX / 4, cv2.BORDER_CONSTANT
    blurred, weight = (
        cv2.GaussianBlur(part, (11, 11), sigma, borderType=constant) for part in (_halved(half) * inside, inside)
    )
    expected = cv2.resize(blurred / np.maximum(weight, 1e-3), half.shape, interpolation=cv2.INTER_LINEAR)
    inside = lit_pixels(*GRID.binned(2).spans(1.0))
    assert np.abs(frame.smooth - expected)[inside].max() < 1e-3
    assert np.abs(levels[1] - np.where(inside, half - expected, 0)).max() < 1e-3
    assert np.abs(levels[2] - _halved(levels[1])).max() < 1e-3

    high_pass(frame, pyramid)
    fine = frame.images[HIGH_PASSED]
    assert abs(fine[lit > 0].mean()) < 1
    assert not fine[lit == 0].any()
