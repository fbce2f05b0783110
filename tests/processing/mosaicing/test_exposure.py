from __future__ import annotations

import cv2
import numpy as np
import pytest

from napari_elsplus.processing.mosaicing.exposure import estimate_frame_gains
from napari_elsplus.processing.mosaicing.mosaic import STILL
from napari_elsplus.processing.tracking.front_end.grid import Grid
from napari_elsplus.processing.tracking.motion.pose import Pose, TrackingState
from napari_elsplus.processing.tracking.motion.rolling_shutter import RollingShutter

GRID = Grid(120, 1, (0, 0), (59.5, 59.5), 118.0, RollingShutter(np.inf))


def path() -> np.ndarray:
    """Places (frames, 2) of the corners of frames there, one row of them on, and back."""
    across = np.arange(0, 240, 8)
    there = [(0, each) for each in across]
    down = [(each, 240) for each in range(8, 60, 8)]
    return np.array(there + down + [(60, each) for each in across[::-1]])


def estimated(light: np.ndarray, seed: int, lost: int | None = None) -> dict[int, float] | None:
    rng = np.random.default_rng(seed)
    scene = 1 + sum(w * cv2.GaussianBlur(rng.standard_normal((400, 500)), (0, 0), s) for w, s in ((1, 2), (15, 30)))
    places = path()
    frames = [
        (light[k] * scene[row : row + 120, col : col + 120] + rng.normal(0, 0.01, (120, 120))).astype(np.float32)
        for k, (row, col) in enumerate(places)
    ]
    states = [TrackingState.LOST if k == lost else TrackingState.TRACKED for k in range(len(places))]
    poses = [
        Pose(0, float(row), float(col), STILL, 1.0, 0.01, state)
        for (row, col), state in zip(places, states, strict=True)
    ]
    return estimate_frame_gains(lambda index: frames[index], poses, GRID)


@pytest.mark.parametrize("seed", range(4))
def test_light_that_falls_to_a_tenth_is_made_up_for_in_every_frame(seed: int) -> None:
    light = np.geomspace(1, 0.1, len(path()))
    gains = estimated(light, seed, lost=20)
    assert gains is not None
    assert 20 not in gains
    left = np.array([gain * light[index] for index, gain in gains.items()])
    assert left == pytest.approx(1.0, abs=0.02)
    assert gains[0] == 1


@pytest.mark.parametrize("seed", range(4))
def test_even_light_is_left_alone(seed: int) -> None:
    assert estimated(np.ones(len(path())), seed) is None


def test_few_frames_have_no_gains() -> None:
    pose = Pose(0, 0.0, 0.0, STILL, 1.0, 0.01, TrackingState.TRACKED)
    assert estimate_frame_gains(lambda index: np.ones((120, 120), np.float32), [pose] * 3, GRID) is None
