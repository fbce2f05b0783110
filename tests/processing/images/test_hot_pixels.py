"""Hot pixels are found in the background, replaced in frames, and cores are not taken for them."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.rigs.random_rigs import Rig
from napari_elsplus.processing.calibration.calibrate import measure
from napari_elsplus.processing.images.hot_pixels import HotPixels
from napari_elsplus.processing.images.sectioning import Sectioner


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
    for seen in (rig.background(50).mean(axis=0, dtype=np.float32), rig.bundle()[0].astype(np.float32)):
        assert len(HotPixels(seen)) == 0
        assert len(HotPixels(seen).dead_columns) == 0


def test_dead_columns_are_replaced_by_those_beside_them() -> None:
    random = np.random.default_rng(1)
    background, raw = random.normal(5, 0.2, (80, 400)), random.integers(40, 60, (80, 400)).astype(np.uint8)
    dead = [120, 121, 300]
    background[:, dead] = raw[:, dead] = 0
    hot = HotPixels(background.astype(np.float32))
    assert hot.dead_columns.tolist() == dead
    mended = hot.mended(raw)
    np.testing.assert_array_equal(mended[:, 121], mended[:, 120])
    np.testing.assert_allclose(mended[:, 300], (raw[:, 299].astype(float) + raw[:, 301]) / 2, atol=0.5)


def test_dead_columns_change_neither_the_gain_nor_the_images() -> None:
    """Three dead columns, two of them in the confocal view, moved the gain by 0.7 %, of which 0.02 % were stated."""
    rig = Rig(left=(150.3, 148.0), right=(141.2, 452.5), diameter_px=270.0, gain=1.05)
    volts = rig.volts(60)
    recordings = {"sweep": rig.sweep(volts), "bundle": rig.bundle(4), "background": rig.background(20)}
    still = rig.bundle(1)
    sound = measure(volts=volts, **{name: list(frames) for name, frames in recordings.items()}).calibration
    for frames in (*recordings.values(), still):
        frames[..., (140, 170, 440)] = 0
    dead = measure(volts=volts, **{name: list(frames) for name, frames in recordings.items()}).calibration
    assert sound.bundle is not None
    assert dead.bundle is not None
    assert dead.bundle.residual_gain == pytest.approx(sound.bundle.residual_gain, abs=5e-4)
    ls = Sectioner(dead, still.shape[1:]).ls(still[0].astype(np.float32))
    assert ls[:, ls.shape[1] // 2 - 10 : ls.shape[1] // 2 + 25].mean(axis=0).min() > 0.8 * ls[:, 100:160].mean()


def test_a_frame_without_hot_pixels_is_not_copied() -> None:
    raw = np.zeros((4, 5), np.uint8)
    assert HotPixels(None).mended(raw) is raw
    assert HotPixels(np.zeros((4, 5), np.float32)).mended(raw) is raw
