"""Frames that show tissue out of focus do not cover those that showed it clearly; of equal ones the newest covers."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from napari_elsplus.processing.mosaicing.clarity import Clarity
from napari_elsplus.processing.mosaicing.mosaic import Mosaic
from napari_elsplus.processing.tracking.front_end.grid import Grid
from napari_elsplus.processing.tracking.motion.rolling_shutter import RollingShutter

SIDE = 120
GRID = Grid(SIDE, 1, (0, 0), ((SIDE - 1) / 2,) * 2, 116.0, RollingShutter(np.inf))


def tissue(seed: int = 0) -> np.ndarray:
    grain = np.random.default_rng(seed).normal(size=(SIDE, SIDE)).astype(np.float32)
    return 100 + 300 * cv2.GaussianBlur(grain, (0, 0), 2.0)


def lifted_on_the_right(image: np.ndarray) -> np.ndarray:
    blurred = 0.5 * cv2.GaussianBlur(image, (0, 0), 4.0)
    return np.where(np.arange(SIDE) < SIDE // 2, image, blurred).astype(np.float32)


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_a_probe_that_loses_contact_on_one_side_does_not_cover_what_was_clear(order: tuple[int, int]) -> None:
    clear = tissue()
    frames = clear, lifted_on_the_right(clear)
    mosaic, clarity = Mosaic(GRID), Clarity(GRID)
    for index in order:
        mosaic.insert(frames[index], 0.0, 0.0, clarity=clarity.of(frames[index]))
    alone = Mosaic(GRID)
    alone.insert(clear, 0.0, 0.0)
    image, expected = mosaic.read()[0], alone.read()[0]
    assert image.shape == expected.shape
    right = np.s_[30:-30, 65:-15]  # beyond the edge of contact and within the rim
    np.testing.assert_allclose(image[right], expected[right], atol=1e-3)


def test_the_newest_of_equally_clear_frames_covers_the_others() -> None:
    mosaic, clarity, random = Mosaic(GRID), Clarity(GRID), np.random.default_rng(1)
    frames = [(tissue() + random.normal(0, 10, (SIDE, SIDE))).astype(np.float32) for _ in range(2)]
    for frame in frames:
        mosaic.insert(frame, 0.0, 0.0, clarity=clarity.of(frame))
    alone = Mosaic(GRID)
    alone.insert(frames[1], 0.0, 0.0)
    np.testing.assert_allclose(mosaic.read()[0], alone.read()[0], atol=1e-3)


def test_frames_without_structure_have_weight() -> None:
    assert Clarity(GRID).of(np.zeros((SIDE, SIDE), np.float32)).min() > 0
