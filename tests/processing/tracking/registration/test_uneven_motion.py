from __future__ import annotations

import cv2
import numpy as np
import pytest

from motion_priors import about
from napari_elsplus.processing.tracking.front_end.grid import Grid
from napari_elsplus.processing.tracking.motion.rolling_shutter import RollingShutter, Warp
from napari_elsplus.processing.tracking.registration.pair_registration import PreparedFrame, Registrar

ROWS_PER_FRAME = 272.0
GRID = Grid(236, 1, (0, 0), (117.5, 117.5), 232.0, RollingShutter(ROWS_PER_FRAME))
MOVED = 5.0, -3.0


def tissue(seed: int) -> np.ndarray:
    noise = np.random.default_rng(seed).normal(size=(400, 400)).astype(np.float32)
    scene = cv2.GaussianBlur(noise, (0, 0), 4.0)
    return 40.0 * scene / scene.std()


def read_while_moving(registrar: Registrar, scene: np.ndarray, shift: tuple[float, ...], jerk: float) -> PreparedFrame:
    """A frame at a shift when its middle row is read, whose acceleration along the columns differs by `jerk`."""
    view, random = registrar.view(), np.random.default_rng(int(10 * jerk) + 1000)
    row, col = np.indices(view.image.shape, dtype=np.float32)
    periods = (row - GRID.centre[0]) / ROWS_PER_FRAME
    col_shift = (82 + shift[1] + jerk * periods**2 / 2).astype(np.float32)
    view.image[:] = cv2.remap(scene, col + col_shift, row + 82 + shift[0], cv2.INTER_CUBIC)
    view.image[:] += cv2.GaussianBlur(random.normal(0, 1, view.image.shape).astype(np.float32), (0, 0), 1.0)
    return registrar.prepare(view)


@pytest.mark.parametrize("jerk", [40.0, -35.0])
def test_the_displacement_of_the_middle_rows_is_right_though_the_acceleration_changed(jerk: float) -> None:
    registrar, scene = Registrar(GRID), tissue(3)
    frames = [read_while_moving(registrar, scene, *at) for at in (((0.0, 0.0), 0.0), (MOVED, jerk))]
    motion = about(GRID.shutter, Warp(b=-MOVED[0], d=-MOVED[1]), 1e-3)
    link = registrar.register(*frames, motion)
    evened = registrar.evened(*frames, motion, link, 30.0)
    assert evened is not None
    error, left = (float(np.hypot(warp.b + MOVED[0], warp.d + MOVED[1])) for warp in (link.warp, evened.warp))
    assert error > 0.4
    assert left < 0.05
    assert left < 4 * evened.sigma + 0.02


def test_far_from_the_middle_rows_an_unknown_acceleration_adds_to_their_uncertainty() -> None:
    registrar, scene = Registrar(GRID), np.zeros((400, 400), np.float32)
    cv2.line(scene, (150, 120), (250, 135), 60.0, 5, cv2.LINE_AA)
    frames = [read_while_moving(registrar, scene, (0.0, 0.0), jerk) for jerk in (0.0, 0.1)]
    motion = about(GRID.shutter, Warp(), 1e-3)
    link = registrar.register(*frames, motion)
    loose, tight = (registrar.evened(*frames, motion, link, sigma) for sigma in (60.0, 1e-3))
    assert loose is not None
    assert tight is not None
    assert loose.sigma > 1.2 * tight.sigma
