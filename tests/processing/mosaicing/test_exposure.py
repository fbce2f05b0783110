from __future__ import annotations

import cv2
import numpy as np
import pytest

from napari_elsplus.processing.mosaicing.exposure import estimate_fading
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


def estimated(light: np.ndarray, seed: int, lost: int | None = None, rise: float = 0.0) -> float | None:
    """Fall of the light per frame; the light also rises across each frame by a factor whose logarithm is given."""
    rng = np.random.default_rng(seed)
    scene = 1 + sum(w * cv2.GaussianBlur(rng.standard_normal((400, 500)), (0, 0), s) for w, s in ((1, 2), (15, 30)))
    places, across = path(), np.exp(rise * np.linspace(-0.5, 0.5, 120))
    frames = [
        (light[k] * across * scene[row : row + 120, col : col + 120] + rng.normal(0, 0.01, (120, 120))).astype(
            np.float32
        )
        for k, (row, col) in enumerate(places)
    ]
    states = [TrackingState.LOST if k == lost else TrackingState.TRACKED for k in range(len(places))]
    poses = [
        Pose(0, float(row), float(col), STILL, 1.0, 0.01, state)
        for (row, col), state in zip(places, states, strict=True)
    ]
    return estimate_fading(lambda index: frames[index], poses, GRID)


@pytest.mark.parametrize("rise", [0.0, 0.3])
@pytest.mark.parametrize("seed", range(4))
def test_the_rate_at_which_light_falls_to_a_tenth_is_found(seed: int, rise: float) -> None:
    frames = len(path())
    rate = estimated(np.geomspace(1, 0.1, frames), seed, lost=20, rise=rise)
    assert rate is not None
    assert rate * (frames - 1) == pytest.approx(np.log(10), abs=0.05)


@pytest.mark.parametrize("rise", [0.0, 0.3])
@pytest.mark.parametrize("seed", range(4))
def test_steady_light_is_left_alone_also_where_it_rises_across_the_frames(seed: int, rise: float) -> None:
    """With a gain for every frame mosaics of a rough rig, at 0.987 of the scene, fell to 0.979."""
    assert estimated(np.ones(len(path())), seed, rise=rise) is None


def test_a_straight_path_tells_no_fading_from_light_that_rises_across_the_frames() -> None:
    places, scene = np.arange(0, 240, 8), 1 + np.random.default_rng(1).random((120, 400))
    frames = [(0.99**k * scene[:, col : col + 120]).astype(np.float32) for k, col in enumerate(places)]
    poses = [Pose(0, 0.0, float(col), STILL, 1.0, 0.01, TrackingState.TRACKED) for col in places]
    assert estimate_fading(lambda index: frames[index], poses, GRID) is None


def test_few_frames_have_no_rate() -> None:
    pose = Pose(0, 0.0, 0.0, STILL, 1.0, 0.01, TrackingState.TRACKED)
    assert estimate_fading(lambda index: np.ones((120, 120), np.float32), [pose] * 3, GRID) is None
