"""Rotation between frames is the probe's only where nothing is strained."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from napari_elsplus.processing.tracking.front_end.grid import Grid
from napari_elsplus.processing.tracking.methods import RegistrationTracking
from napari_elsplus.processing.tracking.motion.pose import Pose, TrackingState
from napari_elsplus.processing.tracking.motion.rolling_shutter import Displacement, RollingShutter, Velocity, Warp
from napari_elsplus.processing.tracking.registration.pair_registration import PairRegistration, Registrar, TrackedPair
from napari_elsplus.processing.tracking.registration.strain_test import probe_turns
from napari_elsplus.processing.tracking.tracker import Tracker

if TYPE_CHECKING:
    from collections.abc import Iterable

SIDE, FRAMES = 128, 60
SHUTTER = RollingShutter(300.0)
GRID = Grid(SIDE, 1, (0, 0), ((SIDE - 1) / 2,) * 2, 124.0, SHUTTER)
ANGLES = 0.012 * np.sin(np.arange(FRAMES) / 9)
AT = 200 * np.exp(1j * np.arange(FRAMES) / 7)  # gains up to 4 pixels per frame period in each


def registered(turns: np.ndarray, shears: np.ndarray, at: np.ndarray = AT) -> tuple[list[Pose], list[TrackedPair]]:
    """Return poses of a probe turned by angles (n,), and registrations of frames besides sheared by `shears` (n,)."""
    rows, own = SHUTTER.line_periods_per_frame, np.exp(-1j * turns)
    velocity, acceleration = np.gradient(at) * own, np.gradient(np.gradient(at)) * own
    poses, links = [], []
    for z, v, angle in zip(at, velocity, turns, strict=True):
        poses.append(Pose(0, z.real, z.imag, Velocity(v.real, v.imag), 1.0, 0.01, TrackingState.TRACKED, angle))
    for k in range(len(at) - 1):
        moved = (at[k + 1] - at[k]) * own[k + 1]
        displacement, before, after = Displacement(moved.real, moved.imag), poses[k].velocity, poses[k + 1].velocity
        a, b, s, d = SHUTTER.warp(before, after, displacement)
        # rows that lie apart are also read at other velocities
        gained = -(acceleration[k] + acceleration[k + 1]) / 2 * b / rows**2
        warp = Warp(a + gained.real, b, s + gained.imag + shears[k + 1] - shears[k], d)
        turn = turns[k + 1] - turns[k]
        link = PairRegistration(warp, np.eye(4), 0.99, 0.9, turn=turn, turn_sigma=1e-4)
        links.append(TrackedPair(k, k + 1, displacement, link))
    return poses, links


def test_a_probe_turns_that_strains_nothing() -> None:
    poses, links = registered(ANGLES, np.zeros(FRAMES))
    assert probe_turns(poses, links, SHUTTER, {})


def test_a_turn_with_as_much_shear_is_deformation() -> None:
    for sign in (-1, 1):
        poses, links = registered(ANGLES, sign * ANGLES)
        assert not probe_turns(poses, links, SHUTTER, {})


def test_velocities_take_lost_frames_into_account() -> None:
    kept = np.delete(np.arange(FRAMES), [20, 21, 40])
    poses, links = registered(ANGLES, np.zeros(FRAMES))
    links = [link._replace(earlier=index, later=index + 1) for index, link in enumerate(links[k] for k in kept[:-1])]
    links = [link for link in links if kept[link.later] == kept[link.earlier] + 1]
    assert probe_turns([poses[k] for k in kept], links, SHUTTER, {20: 2, 38: 1})


class OfImages(RegistrationTracking):
    """Tracks images as they are."""

    def __init__(self) -> None:
        self._tracker = Tracker(Registrar(GRID))


def test_tissue_that_waves_shear_is_not_taken_for_a_turning_probe() -> None:
    random = np.random.default_rng(3)
    scene = cv2.GaussianBlur(random.normal(size=(420, 420)).astype(np.float32), (0, 0), 2.0)
    scene = 100 + 50 * scene / scene.std()
    y, x = np.meshgrid(*(np.arange(SIDE) - middle for middle in GRID.centre), indexing="ij")
    at = 210 + 210j + 80 * np.sin(np.arange(FRAMES) / 8) + 80j * np.cos(np.arange(FRAMES) / 6)
    velocity = np.gradient(at)
    method, images, poses = OfImages(), [], []
    for k in range(FRAMES):
        row = at[k].real + y * (1 + velocity[k].real / 300)
        col = at[k].imag + x + y * velocity[k].imag / 300
        row = row - 1.5 * np.sin(col / 50) * np.sin(k / 9)
        seen = cv2.remap(scene, col.astype(np.float32), row.astype(np.float32), cv2.INTER_CUBIC)
        images.append((seen + random.normal(0, 3, seen.shape)).astype(np.float32) * (np.hypot(y, x) < 62))
        method._tracker.slot()[:] = images[-1]
        poses.append(method._tracker.add())
    passes: dict[str, int] = {}

    def progress(numbers: Iterable[int], step: str, /) -> Iterable[int]:
        passes[step] = len(list(numbers))
        return numbers

    refined = method.refine(poses, lambda index: images[index], progress=progress)
    assert passes == {"Tracking again, with rotation": FRAMES, "Tracking again, without rotation": FRAMES}
    assert all(pose.state is TrackingState.TRACKED for pose in refined)
    assert max(abs(pose.angle) for pose in refined) == 0
    moved = np.diff([pose.at for pose in refined])
    assert np.median(abs(moved - np.diff(at))) < 0.1
