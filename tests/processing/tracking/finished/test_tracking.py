"""Finished images of soft tissue are tracked where they determine the shift, and nowhere else."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
import pytest

from napari_elsplus.processing.tracking.finished.field import FinishedField
from napari_elsplus.processing.tracking.finished.shift_odds import MIN_ODDS_NATS, ShiftOdds
from napari_elsplus.processing.tracking.finished.tracking import FinishedTracking

SIDE = 240


class SoftTissue(NamedTuple):
    """Images (T, SIDE, SIDE) uint8 of deforming tissue, their positions (T, 2), and which are in contact (T,)."""

    images: np.ndarray
    positions: np.ndarray
    contact: np.ndarray


def blurred(rng: np.random.Generator, side: int, px: float) -> np.ndarray:
    """Return Gaussian noise (side, side) of a correlation length in pixels and unit variance."""
    small = max(1, int(px / 3))
    noise = rng.standard_normal((side // small, side // small)).astype(np.float32)
    smooth = cv2.resize(cv2.GaussianBlur(noise, (0, 0), px / small), (side, side), interpolation=cv2.INTER_CUBIC)
    return (smooth - smooth.mean()) / smooth.std()


def soft_tissue(seed: int, frames: int, texture_px: float, strain: float, speed_px: float = 15.0) -> SoftTissue:
    """Return a video with static streaks, changing brightness, noise, and two frames without contact."""
    rng = np.random.default_rng(seed)
    side = 900
    light = 1 / (1 + np.exp(-6 * blurred(rng, side, 45)))
    scene = (15 + 60 * light) * np.exp(0.3 * blurred(rng, side, texture_px) + 0.3 * blurred(rng, side, 3 * texture_px))
    y, x = (np.mgrid[:SIDE, :SIDE].astype(np.float32) - (SIDE - 1) / 2) / (SIDE / 2)
    streaks = np.zeros((SIDE, SIDE), np.float32)
    for _ in range(3):
        ends = rng.uniform(0.25, 0.75, 2) * SIDE + rng.normal(0, 0.08 * SIDE, (2, 2))
        cv2.line(streaks, *(tuple(int(v) for v in end) for end in ends), 1.0, 3)
    seen = (1 - 0.6 * cv2.GaussianBlur(streaks, (0, 0), 1)) * (np.hypot(y, x) < 0.98)
    position, velocity = np.full(2, side / 2), rng.normal(0, speed_px, 2)
    lifted = set(rng.choice(np.arange(3, frames - 3), 2, replace=False).tolist())
    images, positions = [], []
    for k in range(frames):
        a = SIDE / 2 * rng.normal(0, strain, (2, 4))
        down, across = (u[0] * y + u[1] * x + 0.5 * (u[2] * (y * y - 0.25) + u[3] * x * y) for u in a)
        maps = position[1] + SIDE / 2 * x + across, position[0] + SIDE / 2 * y + down
        image = cv2.remap(scene.astype(np.float32), *(m.astype(np.float32) for m in maps), cv2.INTER_LINEAR)
        if k in lifted:
            image = 30 + 6 * blurred(rng, SIDE, 30)
        grain = cv2.GaussianBlur(rng.standard_normal((SIDE, SIDE)).astype(np.float32), (0, 0), 1)
        image = (image + 2.5 * np.sqrt(image) * grain) * seen * rng.uniform(0.85, 1.15)
        images.append(np.clip(image, 0, 255).astype(np.uint8))
        positions.append(position.copy())
        velocity = 0.6 * velocity + rng.normal(0, 0.8 * speed_px, 2) - 0.02 * (position - side / 2)
        position = np.clip(position + velocity, 0.3 * side, 0.7 * side)
    contact = np.array([k not in lifted for k in range(frames)])
    return SoftTissue(np.array(images), np.array(positions), contact)


def tracked(images: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return positions (T, 2), nan where lost, and segments (T,) of finished images."""
    field = FinishedField.of(list(images))
    tracking = FinishedTracking(field)
    poses = [tracking.track(image, image)[0] for image in images]
    refined = tracking.refine(poses, lambda index: field.window(images[index]))
    return np.array([(pose.row, pose.col) for pose in refined]), np.array([pose.segment for pose in refined])


@pytest.mark.parametrize(("texture_px", "strain", "least"), [(3.0, 0.01, 0.95), (5.0, 0.02, 0.9), (8.0, 0.03, 0.5)])
def test_no_wrong_link_in_deforming_soft_tissue(texture_px: float, strain: float, least: float) -> None:
    for seed in (11, 12):
        tissue = soft_tissue(seed, 16, texture_px, strain)
        positions, _ = tracked(tissue.images)
        assert np.isnan(positions[~tissue.contact]).all()
        moves = np.diff(positions, axis=0) - np.diff(tissue.positions, axis=0)
        linked = np.isfinite(moves).all(axis=1)
        assert np.hypot(*moves[linked].T).max() < 8
        assert linked.sum() >= least * (tissue.contact[1:] & tissue.contact[:-1]).sum()


def test_unrelated_images_have_no_odds() -> None:
    tissues = [soft_tissue(seed, 8, texture_px, 0.02) for seed, texture_px in ((21, 3.0), (22, 5.0), (23, 8.0))]
    field = FinishedField.of([image for tissue in tissues for image in tissue.images])
    odds = ShiftOdds(field.mask, field.coarse_diameter)
    spectra = [
        [odds.spectra(field.coarse_logarithm(field.window(image))) for image in tissue.images] for tissue in tissues
    ]
    worst = max(odds.best(a, b).odds for a in spectra[0] for group in spectra[1:] for b in group)
    assert worst < MIN_ODDS_NATS / 2


def test_rigid_images_are_tracked_to_a_fraction_of_a_pixel() -> None:
    scene = 100 + 20 * blurred(np.random.default_rng(3), 600, 2.5)
    places = [(100.0 + 7.3 * k, 120.0 + 11.6 * k) for k in range(12)]
    images = np.stack([cv2.getRectSubPix(scene, (200, 220), (col + 99.5, row + 109.5)) for row, col in places])
    positions, _ = tracked(images)
    np.testing.assert_allclose(positions, np.subtract(places, places[0]), atol=0.25)


def rigid(places: np.ndarray, seed: int) -> np.ndarray:
    """Return images (T, 200, 200) uint8 of a rigid scene at positions (T, 2), with noise."""
    rng = np.random.default_rng(seed)
    scene = 100 + 20 * blurred(rng, int(places.max()) + 260, 2.5)
    disc = np.hypot(*(np.mgrid[:200, :200] - 99.5)) < 98
    seen = [cv2.getRectSubPix(scene, (200, 200), (col + 120, row + 120)) for row, col in places]
    return np.array([np.clip((image + rng.normal(0, 6, image.shape)) * disc, 0, 255) for image in seen], np.uint8)


@pytest.mark.parametrize(
    ("speed_px", "frames", "around", "limit_px"), [(1.5, 40, False, 0.1), (22.0, 60, True, 0.2)], ids=["slow", "loop"]
)
def test_errors_do_not_add_up_in_rigid_scenes(speed_px: float, frames: int, around: bool, limit_px: float) -> None:
    angle = 2.4 * np.pi * np.arange(frames) / frames
    radius = speed_px * frames / (2.4 * np.pi)
    loop = radius * np.stack([1 + np.sin(angle), 1 - np.cos(angle)], 1)
    places = loop if around else np.arange(frames)[:, None] * speed_px * np.array([0.6, 0.8])
    largest = []
    for seed in (5, 6):
        positions, segments = tracked(rigid(places, seed))
        assert set(segments) == {0}
        largest.append(np.hypot(*(positions - positions[0] - places + places[0]).T).max())
    assert np.mean(largest) < limit_px


def test_repeated_frames_have_the_place_of_their_twin() -> None:
    tissue = soft_tissue(31, 9, 3.0, 0.0)
    alone, alone_segments = tracked(tissue.images)
    twice = np.repeat(tissue.images, 2, axis=0)
    twice[1::2][:, ::7, ::5] += 1  # as video compression changes a copy
    positions, segments = tracked(twice)
    np.testing.assert_array_equal(positions[::2], positions[1::2])
    np.testing.assert_allclose(positions[::2], alone, atol=1e-6)
    np.testing.assert_array_equal(segments[::2], alone_segments)
    assert all((segments[np.isfinite(positions[:, 0])] == one).sum() > 2 for one in set(segments))


def test_the_field_is_the_lit_disc_of_images_that_are_not_square() -> None:
    y, x = np.mgrid[:236, :300]
    rng = np.random.default_rng(0)
    disc = np.hypot(y - 120, x - 170) < 110
    field = FinishedField.of([np.where(disc, rng.uniform(20, 90, disc.shape), 0.0) for _ in range(9)])
    centre = np.add(field.grid.origin, field.grid.centre)
    np.testing.assert_allclose(centre, (120, 170), atol=1.5)
    assert 0.9 * field.grid.diameter == pytest.approx(216, abs=4)
