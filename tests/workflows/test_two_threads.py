from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from napari_elsplus.errors import InputError
from napari_elsplus.processing.tracking.registry import Method
from napari_elsplus.workflows.mosaic_plan import MosaicPlan
from napari_elsplus.workflows.tracked_stack import TrackedStack
from napari_elsplus.workflows.two_threads import IMAGES_AHEAD, ComputedAhead
from recordings import Truth, record, smooth_path, texture


@pytest.fixture(scope="module")
def truth() -> Truth:
    return record(texture(1000, 4), smooth_path(24, 12.0, 1000, 4))


def stack(truth: Truth, frames: Sequence[np.ndarray], method: Method = Method.ELSPLUS) -> TrackedStack:
    return TrackedStack(frames, truth.calibration, MosaicPlan(method=method))


@pytest.mark.parametrize("method", list(Method))
def test_two_threads_give_what_one_gives_bit_for_bit(truth: Truth, method: Method) -> None:
    frames = truth.frames.copy()
    frames[9:11] = 4  # dark: these are predicted
    one, two = stack(truth, frames, method), stack(truth, frames, method)
    one.track(grow=False, threads=1)
    two.track(grow=False, threads=2)
    assert repr(two.lead.rows) == repr(one.lead.rows)  # as texts, in which nan equals nan
    assert repr(two.lead.poses) == repr(one.lead.poses)
    assert len(two.lead.rows) == len(frames)


def test_images_are_made_on_another_thread_a_few_ahead_of_the_frame_that_is_registered(truth: Truth) -> None:
    two, made_on, ahead = stack(truth, truth.frames), set(), []
    prepare_image = two.lead.tracking.prepare_image

    def counted(*arguments):
        made_on.add(threading.current_thread().name)
        ahead.append(len(ahead) - len(two.lead.rows))
        prepare_image(*arguments)

    two.lead.tracking.prepare_image = counted
    two.track(grow=False, threads=2)
    assert max(ahead) <= IMAGES_AHEAD
    assert made_on
    assert threading.current_thread().name not in made_on
    assert not any(thread.name in made_on for thread in threading.enumerate())


@pytest.mark.parametrize("stage", ["prepare_image", "estimate_pose"])
def test_what_goes_wrong_with_a_frame_is_raised_and_ends_the_other_thread(truth: Truth, stage: str) -> None:
    two = stack(truth, truth.frames)
    work, count = getattr(two.lead.tracking, stage), iter(range(100))

    def breaks(*arguments):
        if next(count) == 5:
            raise InputError("the sixth frame", "leave it out")
        return work(*arguments)

    setattr(two.lead.tracking, stage, breaks)
    with pytest.raises(InputError, match="the sixth frame"):
        two.track(grow=False, threads=2)
    assert [row.frame for row in two.lead.rows] == list(range(5))
    assert not any(thread.name.startswith("images") for thread in threading.enumerate())


@pytest.mark.parametrize("error", [ValueError, SystemExit])
@pytest.mark.parametrize("threads", [1, 2])
def test_images_computed_ahead_are_those_of_one_thread_and_the_same_error_comes_in_its_place(
    threads: int, error: type[BaseException]
) -> None:
    def make(number: int) -> NDArray[np.float32]:
        if number == 9:
            raise error("the tenth")
        return np.full((2, 2), number, np.float32)

    ahead = iter(ComputedAhead(make, ((number,) for number in range(12)), 12, threads=threads))
    assert [int(next(ahead)[0, 0]) for _ in range(9)] == list(range(9))
    with pytest.raises(error, match="the tenth"):
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
