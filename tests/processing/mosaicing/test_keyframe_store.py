"""Keyframe store: dense while memory allows, never above its capacity."""

from __future__ import annotations

import numpy as np
import pytest

from napari_elsplus.processing.mosaicing.keyframe_store import MAX_SPACING, MIN_SPACING, KeyframeStore
from napari_elsplus.processing.tracking.motion.pose import Pose, TrackingState
from napari_elsplus.processing.tracking.motion.rolling_shutter import Velocity

DIAMETER = 200.0
IMAGE = np.zeros((4, 4), np.float32)


def pose(row: float, col: float, segment: int = 0) -> Pose:
    return Pose(segment, row, col, Velocity(0.0, 1.0), 0.9, 0.1, TrackingState.TRACKED)


def test_grey_levels_come_back_within_a_thirty_second_and_exposed() -> None:
    image = np.random.default_rng(0).uniform(-300, 1300, (40, 40)).astype(np.float32)
    store = KeyframeStore(DIAMETER, 5)
    assert store.add(0, pose(0, 0), image, exposure=1.25)
    back = store.frames[0].image(np.empty_like(image))
    assert np.abs(back - 1.25 * image).max() <= 1 / 32 + 1e-3


@pytest.mark.parametrize(("level", "exposure"), [(1100.0, 2.0), (-1500.0, 1.5), (60_000.0, 1.0)])
def test_bright_frames_keep_their_sign_and_their_level(level: float, exposure: float) -> None:
    """Of cameras of more than eight bits, and of frames that exposure matching has brightened."""
    image = np.array([[level, 0.0], [level / 2, 1.0]], np.float32)
    store = KeyframeStore(DIAMETER, 5)
    assert store.add(0, pose(0, 0), image, exposure=exposure)
    back = store.frames[0].image(np.empty_like(image))
    np.testing.assert_allclose(back, exposure * image, atol=max(1 / 32, abs(exposure * level) / 32767) + 1e-3)


def test_what_is_passed_again_and_again_takes_no_more_room_and_the_newest_stay() -> None:
    store = KeyframeStore(DIAMETER, capacity=80)
    for frame in range(2000):
        t = 2 * np.pi * frame / 100
        store.add(frame, pose(80 * np.sin(t), 80 * np.cos(t)), IMAGE)
        if store.needs_thinning:
            store.thin(lambda one: one.pose)
    assert len(store.frames) <= 80
    assert not store.full
    assert store.spacing == MIN_SPACING
    assert min(one.frame for one in store.frames) > 1800


def test_memory_grows_with_the_area_and_not_with_time() -> None:
    store = KeyframeStore(DIAMETER, capacity=100_000)
    most = 0
    for frame in range(6000):
        t = 2 * np.pi * frame / 100
        store.add(frame, pose(200 * np.sin(t), 200 * np.cos(t)), IMAGE)
        if store.needs_thinning:
            store.thin(lambda one: one.pose)
        most = max(most, len(store.frames))
    assert most <= 1000
    assert store.spacing == MIN_SPACING


def test_a_long_way_is_kept_more_and_more_sparsely_until_it_would_have_gaps() -> None:
    store = KeyframeStore(DIAMETER, capacity=100)
    spacings = []
    frame = 0
    while not store.full:
        store.add(frame, pose(0.0, 5.0 * frame), IMAGE)
        if store.needs_thinning:
            store.thin(lambda one: one.pose)
            spacings.append(store.spacing)
        frame += 1
    assert spacings == sorted(spacings)
    assert spacings[-1] == MAX_SPACING
    cols = np.array([one.pose.col for one in store.frames])
    assert np.diff(cols).max() <= 2 * MAX_SPACING * DIAMETER
    assert 5.0 * frame > 75 * MAX_SPACING * DIAMETER
    assert not store.add(frame, pose(0.0, 1e6), IMAGE)


@pytest.mark.parametrize("always", [False, True])
def test_a_frame_near_the_last_one_is_kept_only_where_it_must_be(always: bool) -> None:
    store = KeyframeStore(DIAMETER, 10)
    store.add(0, pose(0, 0), IMAGE)
    assert store.add(1, pose(0, 1), IMAGE, always=always) == always
    assert store.add(2, pose(0, 1, segment=1), IMAGE)
    store.discard({1})
    assert {one.pose.segment for one in store.frames} == {0}
