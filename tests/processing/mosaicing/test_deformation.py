"""Fields of deforming tissue are found and undone, and rigid scenes are left as they are."""

from __future__ import annotations

import cv2
import numpy as np

from napari_elsplus.processing.mosaicing.deformation.estimation import estimate_deformation
from napari_elsplus.processing.mosaicing.deformation.fields import Deformation, legendre_terms
from napari_elsplus.processing.mosaicing.mosaic import Insertion, Mosaic
from napari_elsplus.processing.tracking.front_end.grid import Grid
from napari_elsplus.processing.tracking.motion.pose import Pose, TrackingState
from napari_elsplus.processing.tracking.motion.rolling_shutter import RollingShutter, Velocity

SIDE, FRAMES = 128, 24
GRID = Grid(SIDE, 1, (0, 0), ((SIDE - 1) / 2,) * 2, 124.0, RollingShutter(300.0))
STRAIN, WAVE_PX = 0.03, 200.0
VELOCITY = Velocity(12.0, -6.0)


def scanned(strain: float, seed: int = 0) -> tuple[np.ndarray, list[np.ndarray], list[Pose]]:
    """Return a scene, and frames and poses of a moving probe over it while it is stretched to and fro."""
    random = np.random.default_rng(seed)
    scene = cv2.GaussianBlur(random.normal(size=(320, 320)).astype(np.float32), (0, 0), 2.0)
    scene = 100 + 50 * scene / scene.std()
    y, x = np.meshgrid(*(np.arange(SIDE) - middle for middle in GRID.centre), indexing="ij")
    rows = GRID.shutter.line_periods_per_frame
    images, poses = [], []
    for k in range(FRAMES):
        turn = 2 * np.pi * k / FRAMES
        row, col = 160 + 40 * np.sin(turn), 160 + 40 * np.cos(2 * turn)
        r, c = row + y * (1 + VELOCITY.row / rows), col + x + y * VELOCITY.col / rows
        push = strain * WAVE_PX / (2 * np.pi) * np.sin(2 * np.pi * c / WAVE_PX + seed) * np.sin(2 * turn)
        seen = cv2.remap(scene, (c - push).astype(np.float32), (r - push).astype(np.float32), cv2.INTER_CUBIC)
        seen += random.normal(0, 3, seen.shape).astype(np.float32)
        images.append(seen * (np.hypot(y, x) < 62))
        poses.append(Pose(0, row, col, VELOCITY, 1.0, 0.01, TrackingState.TRACKED))
    return scene, images, poses


def mosaic_of(images: list[np.ndarray], poses: list[Pose]) -> Mosaic:
    mosaic = Mosaic(GRID, Insertion.DEAD_LEAF)
    for image, pose in zip(images, poses, strict=True):
        mosaic.insert(image, pose.row, pose.col, pose.velocity)
    return mosaic


def correlation(mosaic: Mosaic, scene: np.ndarray) -> float:
    assert mosaic.extent is not None
    image, weight = mosaic.read()
    there = scene[mosaic.extent.top : mosaic.extent.bottom, mosaic.extent.left : mosaic.extent.right]
    return float(np.corrcoef(image[weight > 0], there[weight > 0])[0, 1])


def correlation_at_any_shift(mosaic: Mosaic, scene: np.ndarray) -> float:
    assert mosaic.extent is not None
    image, weight = mosaic.read()
    inner = np.ascontiguousarray(image[10:-10, 10:-10], np.float32)
    shown = (weight[10:-10, 10:-10] > 0).astype(np.float32)
    top, left, bottom, right = mosaic.extent.top, mosaic.extent.left, mosaic.extent.bottom, mosaic.extent.right
    there = np.ascontiguousarray(scene[top:bottom, left:right], np.float32)
    return float(cv2.matchTemplate(there, inner, cv2.TM_CCOEFF_NORMED, mask=shown).max())


def test_tissue_that_deforms_by_3_percent_is_drawn_in_its_mean_shape() -> None:
    for seed in range(3):
        scene, images, poses = scanned(STRAIN, seed)
        before = mosaic_of(images, poses)
        found = estimate_deformation(lambda k, images=images: images[k], poses, GRID)
        assert found is not None
        after = mosaic_of([found.undone(k, image) for k, image in enumerate(images)], poses)
        assert 1 - correlation(after, scene) < 0.5 * (1 - correlation(before, scene))


def test_frames_that_the_track_misplaces_over_deforming_tissue_are_drawn_where_they_belong() -> None:
    """Displacements over strained tissue add up to a drift, which frames show that see a place again."""
    scene, images, poses = scanned(STRAIN, seed=1)
    tracked = [pose._replace(row=pose.row + 0.15 * k, col=pose.col - 0.1 * k) for k, pose in enumerate(poses)]
    found = estimate_deformation(lambda k: images[k], tracked, GRID)
    assert found is not None
    drawn = mosaic_of([found.undone(k, image) for k, image in enumerate(images)], tracked)
    before = correlation_at_any_shift(mosaic_of(images, tracked), scene)
    assert 1 - correlation_at_any_shift(drawn, scene) < 0.1 * (1 - before)


def test_uneven_motion_within_frames_is_no_deformation() -> None:
    """It displaces whole rows, as no wave does."""
    _, images, poses = scanned(0.0)
    y, x = (axis.astype(np.float32) for axis in np.mgrid[:SIDE, :SIDE])
    jerked = []
    for k, image in enumerate(images):
        across = x + (-1) ** k * 2.0 * ((y - SIDE / 2) / (SIDE / 2)) ** 2
        jerked.append(cv2.remap(image, across.astype(np.float32), y, cv2.INTER_LINEAR))
    assert estimate_deformation(lambda k: jerked[k], poses, GRID) is None


def test_a_rigid_scene_is_left_as_it_is() -> None:
    for seed in range(3):
        _, images, poses = scanned(0.0, seed)
        assert estimate_deformation(lambda k, images=images: images[k], poses, GRID) is None


def test_a_picture_that_is_always_the_same_is_left_as_it_is() -> None:
    _, images, poses = scanned(0.0)
    assert estimate_deformation(lambda _: images[0], [poses[0]] * FRAMES, GRID) is None


def test_an_image_without_a_field_is_left_as_it_is() -> None:
    image = np.ones((SIDE, SIDE), np.float32)
    assert Deformation(GRID).undone(0, image) is image


def test_tissue_has_the_shape_about_which_it_moves() -> None:
    """Fields that are as small as can be left a static one to chance: what the tissue was strained by in passing."""
    random, frames = np.random.default_rng(4), 160
    radius = 0.45 * GRID.diameter
    y, x = np.meshgrid(*2 * [np.linspace(-0.9, 0.9, 9)], indexing="ij")
    points = np.stack([y, x])[:, np.hypot(y, x) < 1]
    to_terms, wave = np.linalg.pinv(legendre_terms(points)), 2 * np.pi / 260
    at = 150 * np.array([np.sin(np.arange(frames) / 11), np.cos(np.arange(frames) / 7)]).T
    deformation, motion = Deformation(GRID), []
    for k, place in enumerate(at):
        tissue = radius * points + place[:, None]
        motion.append(2 * np.sin(wave * tissue + random.uniform(-0.1, 0.1)) * np.cos(k / 6) @ to_terms)
        static = 2 * np.cos(wave * tissue[::-1]) @ to_terms
        deformation._fields[k] = motion[-1] + static + np.outer(random.normal(0, 1, 2), np.arange(10) == 0)
    poses = [Pose(0, row, col, VELOCITY, 1.0, 0.01, TrackingState.TRACKED) for row, col in at]

    def missed() -> float:
        """Return how far the fields are from the tissue's motion, shifts apart (root mean square, pixels)."""
        left = [(deformation._fields[k] - motion[k])[:, 1:] for k in range(frames)]
        return float(np.sqrt(np.square(left).sum(axis=(1, 2)).mean()))

    before = missed()
    deformation.settle(poses)
    assert missed() < 0.4 * before


def test_the_shapes_of_two_segments_have_nothing_in_common() -> None:
    deformation = Deformation(GRID)
    stretched = np.zeros((2, 10))
    stretched[0, 4] = 1.0
    poses = [Pose(k // 20, 20.0 * (k % 20), 0.0, VELOCITY, 1.0, 0.01, TrackingState.TRACKED) for k in range(40)]
    deformation._fields = {k: stretched * (k >= 20) for k in range(40)}
    deformation.settle(poses)
    assert all(not deformation._fields[k].any() for k in range(20))
    assert all(abs(deformation._fields[k][0, 4]) < 0.3 for k in range(20, 40))
