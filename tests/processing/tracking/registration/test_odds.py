from __future__ import annotations

import cv2
import numpy as np
import pytest

from motion_priors import about
from napari_elsplus.processing.tracking.front_end.grid import Grid
from napari_elsplus.processing.tracking.motion.rolling_shutter import RollingShutter, Warp
from napari_elsplus.processing.tracking.registration.pair_registration import PreparedFrame, Registrar

GRID = Grid(236, 1, (0, 0), (117.5, 117.5), 232.0, RollingShutter(280.0))
MOVED = (3.0, -2.0)


def seen(
    registrar: Registrar, scene: np.ndarray, shift: tuple[float, float], seed: int, cores: np.ndarray | None = None
) -> PreparedFrame:
    view = registrar.view()
    centre = (scene.shape[1] / 2 + shift[1], scene.shape[0] / 2 + shift[0])
    view.image[:] = cv2.getRectSubPix(scene, view.image.shape, centre)
    if cores is not None:
        view.image[:] *= cores
    noise = np.random.default_rng(seed).normal(0, 2.0, view.image.shape).astype(np.float32)
    view.image[:] += cv2.GaussianBlur(noise, (0, 0), 1.0)
    return registrar.prepare(view)


def one_fibre(*, ends: bool) -> np.ndarray:
    scene = np.zeros((500, 500), np.float32)
    cv2.line(scene, (-50, 250 - 180), (260 if ends else 550, 258 if ends else 433), 60.0, 5, cv2.LINE_AA)
    return cv2.GaussianBlur(scene, (0, 0), 1.2)


@pytest.mark.parametrize("seed", range(4))
def test_the_end_of_one_fibre_is_enough_and_a_fibre_without_ends_is_not(seed: int) -> None:
    registrar = Registrar(GRID)
    links = []
    for ends in (True, False):
        frames = [seen(registrar, one_fibre(ends=ends), shift, 2 * seed + k) for k, shift in enumerate(((0, 0), MOVED))]
        links.append(registrar.register(*frames, about(GRID.shutter, Warp(b=-MOVED[0], d=-MOVED[1]), 1e-3)))
    ended, endless = links
    assert ended.observed
    assert np.hypot(ended.warp.b + MOVED[0], ended.warp.d + MOVED[1]) < 0.5
    assert not endless.observed


@pytest.mark.parametrize("seed", range(4))
def test_cores_of_unlike_gain_along_a_fibre_are_no_evidence_that_it_rests(seed: int) -> None:
    registrar, scene = Registrar(GRID), one_fibre(ends=False)
    along = 3.0 * np.array([613.0, 600.0]) / np.hypot(613.0, 600.0)
    gains = cv2.GaussianBlur(np.random.default_rng(seed).normal(size=(236, 236)).astype(np.float32), (0, 0), 1.5)
    cores = 1 + 0.06 * gains / gains.std()
    frames = [seen(registrar, scene, tuple(k * along), 2 * seed + k, cores) for k in range(2)]
    link = registrar.register(*frames, about(GRID.shutter, Warp(), 1e-3))
    assert np.hypot(link.warp.b, link.warp.d) < 1.5, "the cores pull the shift to zero"
    assert not link.observed


def test_frames_that_share_only_noise_are_rejected() -> None:
    registrar, empty = Registrar(GRID), np.zeros((500, 500), np.float32)
    for seed in range(6):
        frames = [seen(registrar, empty, (0.0, 0.0), 2 * seed + k) for k in range(2)]
        found = registrar.register(*frames, about(GRID.shutter, Warp(), shift_px=60.0), anywhere=True)
        assert found is None or not found.observed
