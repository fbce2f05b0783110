"""Hot pixels are found in the background, replaced in frames, and cores are not taken for them."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.rigs.random_rigs import Rig
from napari_elsplus.processing.images.hot_pixels import HotPixels


def test_hot_pixels_are_replaced_by_the_median_of_their_neighbours() -> None:
    random = np.random.default_rng(0)
    background = random.normal(5, 0.2, (60, 90)).astype(np.float32)
    raw = random.integers(40, 60, background.shape).astype(np.uint8)
    places = [(10, 20), (0, 0), (59, 44), (30, 89)]
    for row, col in places:
        background[row, col] += 40
        raw[row, col] = 255
    hot = HotPixels(background)
    assert sorted(zip(hot.rows.tolist(), hot.cols.tolist(), strict=True)) == sorted(places)
    mended = hot.mended(raw)
    assert mended.dtype == raw.dtype
    assert mended[10, 20] == int(np.median(np.delete(raw[9:12, 19:22].ravel(), 4)))
    assert mended.max() < 60
    assert raw.max() == 255


@pytest.mark.parametrize("seed", range(5))
def test_neither_noise_nor_cores_are_hot(seed: int) -> None:
    rig = Rig.draw(seed)
    assert len(HotPixels(rig.background(50).mean(axis=0, dtype=np.float32))) == 0
    assert len(HotPixels(rig.bundle()[0].astype(np.float32))) == 0


def test_a_frame_without_hot_pixels_is_not_copied() -> None:
    raw = np.zeros((4, 5), np.uint8)
    assert HotPixels(None).mended(raw) is raw
    assert HotPixels(np.zeros((4, 5), np.float32)).mended(raw) is raw
