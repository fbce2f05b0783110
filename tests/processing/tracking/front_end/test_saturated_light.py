from __future__ import annotations

import numpy as np
import pytest

from napari_elsplus.processing.tracking.front_end.saturated_light import SaturatedLight


@pytest.mark.parametrize(
    ("dtype", "limit"), [(np.uint8, 255), (np.uint16, 4095), (np.uint16, 65520), (np.float32, 1000)]
)
def test_light_beyond_saturation_is_estimated_by_the_cores_of_the_background(dtype: type, limit: int) -> None:
    row, col = np.mgrid[:60, :80]
    cores = np.random.default_rng(0).uniform(0.2, 1.8, row.shape)
    light = limit * cores * (0.7 + 0.3 * np.sin(row / 15) * np.cos(col / 20))
    black = limit / 50
    frame = np.minimum(black + light, limit).astype(dtype)
    background = (black + limit / 20 * cores).astype(np.float32)
    saturated = frame == limit
    assert 0.1 < saturated.mean() < 0.4
    estimate = SaturatedLight(background, black, float(background.mean()), 3)
    assert estimate.known(limit)
    beyond, unit = estimate.beyond(frame, limit)
    assert beyond.dtype == dtype
    assert not beyond[~saturated].any()
    missed = (frame + unit * beyond.astype(np.float64)) / (black + light) - 1
    inner = saturated.copy()
    inner[[0, -1], :] = inner[:, [0, -1]] = False
    assert np.sqrt(np.mean(missed[inner] ** 2)) < 0.03


def test_a_background_without_light_shows_no_cores() -> None:
    noise = np.random.default_rng(0).normal(4, 0.3, (60, 80)).astype(np.float32)
    assert not SaturatedLight(noise, float(np.percentile(noise, 5)), float(noise.mean()), 3).known(255)
