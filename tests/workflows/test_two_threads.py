from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from napari_elsplus.errors import InputError
from napari_elsplus.processing.tracking.registry import Method
from napari_elsplus.workflows.tracking import Pipeline
from napari_elsplus.workflows.two_threads import AHEAD, ComputedAhead, Pipelined
from recordings import Truth, record, smooth_path, texture


@pytest.fixture(scope="module")
def truth() -> Truth:
    return record(texture(1000, 4), smooth_path(24, 12.0, 1000, 4))


def pipeline(truth: Truth, method: Method = Method.ELSPLUS) -> Pipeline:
    return Pipeline(truth.calibration, truth.frames.shape[1:], method=method)


def add_all(target: Pipeline, frames: Sequence[np.ndarray]) -> None:
    with Pipelined(target) as threads:
        for index, raw in enumerate(frames):
            threads.add(raw, index)


@pytest.mark.parametrize("method", list(Method))
@pytest.mark.parametrize("lay", [True, False])
def test_two_threads_give_what_one_gives_bit_for_bit(truth: Truth, method: Method, lay: bool) -> None:
    frames = truth.frames.copy()
    frames[9:11] = 4  # dark: these are predicted
    one, two = pipeline(truth, method), pipeline(truth, method)
    for index, raw in enumerate(frames):
        (one.add if lay else one.track)(raw, index, index / 240)
    camera = np.empty_like(frames[0])
    with Pipelined(two, insert=lay) as threads:
        for index, raw in enumerate(frames):
            camera[:] = raw  # its memory is used again as soon as the call returns
            threads.add(camera, index, index / 240)
    assert repr(two.rows) == repr(one.rows)  # as texts, in which nan equals nan
    assert repr(two.poses) == repr(one.poses)
    assert set(two.mosaics) == set(one.mosaics)
    for segment, mosaic in one.mosaics.items():
        for mine, others in zip(mosaic.read(), two.mosaics[segment].read(), strict=True):
            np.testing.assert_array_equal(mine, others)


def test_frames_are_linked_on_another_thread_and_no_more_than_a_few_are_under_way(truth: Truth) -> None:
    two, gate, linked_on, looked = pipeline(truth), threading.Event(), set(), []
    estimate_pose, prepare_image = two.estimate_pose, two.prepare_image

    def slow_pose(image):
        gate.wait(100)
        linked_on.add(threading.current_thread().name)
        return estimate_pose(image)

    def counted_images(*arguments):
        looked.append(len(two.rows))
        if len(looked) == AHEAD:
            gate.set()
        prepare_image(*arguments)

    two.estimate_pose, two.prepare_image = slow_pose, counted_images
    add_all(two, truth.frames)
    assert looked[:AHEAD] == [0] * AHEAD  # while the first is linked, so many are taken
    assert all(index - done <= AHEAD for index, done in enumerate(looked))
    assert linked_on
    assert threading.current_thread().name not in linked_on
    assert [row.frame for row in two.rows] == list(range(len(truth.frames)))
    assert not any(thread.name in linked_on for thread in threading.enumerate())


def test_what_goes_wrong_in_linking_is_raised_and_ends_the_other_thread(truth: Truth) -> None:
    two = pipeline(truth)
    estimate_pose, count = two.estimate_pose, iter(range(100))

    def breaks(image):
        if next(count) == 5:
            raise InputError("the sixth frame", "leave it out")
        return estimate_pose(image)

    two.estimate_pose = breaks
    with pytest.raises(InputError, match="the sixth frame"):
        add_all(two, truth.frames)
    assert [row.frame for row in two.rows] == list(range(5))
    assert not any(thread.name.startswith("link") for thread in threading.enumerate())


def test_frames_before_one_of_another_size_are_in_the_track(truth: Truth) -> None:
    two = pipeline(truth)
    with pytest.raises(InputError, match="one size"):
        add_all(two, [*truth.frames[:6], truth.frames[6][:50]])
    assert [row.frame for row in two.rows] == list(range(6))
    assert not any(thread.name.startswith("link") for thread in threading.enumerate())


@pytest.mark.parametrize("threads", [1, 2])
def test_images_computed_ahead_are_those_of_one_thread_and_the_same_error_comes_in_its_place(threads: int) -> None:
    def make(number: int) -> NDArray[np.float32]:
        if number == 9:
            raise ValueError("the tenth")
        return np.full((2, 2), number, np.float32)

    ahead = iter(ComputedAhead(make, ((number,) for number in range(12)), 12, threads=threads))
    assert [int(next(ahead)[0, 0]) for _ in range(9)] == list(range(9))
    with pytest.raises(ValueError, match="the tenth"):
        next(ahead)
    assert not any(thread.name.startswith("images") for thread in threading.enumerate())


def test_frames_of_images_computed_ahead_are_read_by_the_caller_and_an_error_in_reading_is_raised() -> None:
    readers, makers = set(), set()

    def frames() -> Iterator[tuple[int]]:
        for number in range(6):
            readers.add(threading.current_thread())
            yield (number,)
        raise OSError("the seventh")

    def make(number: int) -> NDArray[np.float32]:
        makers.add(threading.current_thread())
        return np.full((2, 2), number, np.float32)

    with pytest.raises(OSError, match="the seventh"):
        list(ComputedAhead(make, frames(), 8))
    assert readers == {threading.current_thread()}
    assert len(makers | readers) == 2
    assert not any(thread.name.startswith("images") for thread in threading.enumerate())
