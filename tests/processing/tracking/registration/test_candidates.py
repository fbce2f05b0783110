"""Searches of all shifts under a pattern that does not move with the specimen."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from motion_priors import about
from napari_elsplus.processing.tracking.front_end.grid import Grid
from napari_elsplus.processing.tracking.motion.rolling_shutter import RollingShutter, Warp
from napari_elsplus.processing.tracking.registration.pair_registration import PairRegistration, Registrar
from recordings import texture

DIAMETER = 220.0
MOVED = (14, -15)


def grid() -> Grid:
    side = int(DIAMETER) + 12
    return Grid(side, 1, (0, 0), ((side - 1) / 2, (side - 1) / 2), DIAMETER, RollingShutter(np.inf))


def registered(earlier: np.ndarray, later: np.ndarray) -> PairRegistration:
    registrar = Registrar(grid())
    rows, cols = np.indices((registrar.grid.side,) * 2) - registrar.grid.centre[0]
    lit = np.hypot(rows, cols) < DIAMETER / 2
    views = [registrar.view(), registrar.view()]
    for view, image in zip(views, (earlier, later), strict=True):
        view.image[:] = lit * image
        registrar.prepare(view)
    link = registrar.search(*views, about(registrar.grid.shutter, Warp()), 60.0)
    assert link is not None
    return link


def views_of(moved: tuple[int, int], seed: int, strength: float) -> list[np.ndarray]:
    """Two noisy images of a texture, a pattern of that relative strength over both."""
    random = np.random.default_rng(seed)
    scene, side = 200 * texture(400, seed), grid().side
    pattern = cv2.GaussianBlur(random.normal(size=(side, side)), (0, 0), 2.0)
    factor = 1 + strength * pattern / pattern.std()
    return [
        scene[80 + row : 80 + row + side, 80 + col : 80 + col + side] * factor + random.normal(0, 2, (side, side))
        for row, col in ((0, 0), moved)
    ]


@pytest.mark.parametrize("seed", range(3))
def test_a_specimen_is_followed_under_a_stronger_static_pattern(seed: int) -> None:
    link = registered(*views_of(MOVED, seed, 0.4))
    assert np.hypot(link.warp.b + MOVED[0], link.warp.d + MOVED[1]) < 2


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("degrees", [0.0, 2.0])
def test_a_specimen_at_rest_is_not_taken_for_a_static_pattern(seed: int, degrees: float) -> None:
    """Nor one that rotates, of which a translation leaves much unexplained."""
    earlier, later = views_of((0, 0), seed, 0.0)
    turn = cv2.getRotationMatrix2D(grid().centre[::-1], degrees, 1.0)
    link = registered(earlier, cv2.warpAffine(later, turn, later.shape))
    assert np.hypot(link.warp.b, link.warp.d) < 1.5
