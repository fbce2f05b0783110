from __future__ import annotations

import gc
import os
import sys
from threading import Thread

import pytest

from napari_elsplus.hardware.priority import (
    Rank,
    full_collections_deferred,
    join_frame_core,
    keep_pace,
    leave_frame_core,
    ordinary_priority,
    settle_memory,
)


@pytest.mark.skipif(sys.platform != "linux", reason="policies of scheduling are those of Linux")
def test_priority_is_ordinary_within_the_context_and_as_before_after_it() -> None:
    if not keep_pace():
        pytest.skip("this user may not have real-time priority")
    with ordinary_priority():
        assert os.sched_getscheduler(0) == os.SCHED_OTHER
    assert os.sched_getscheduler(0) == os.SCHED_RR


@pytest.mark.skipif(sys.platform != "linux", reason="policies of scheduling are those of Linux")
def test_no_test_has_the_priority_that_an_earlier_one_took() -> None:
    """Before: after the test above, or a command that keeps the camera's pace, all others held up the computer."""
    assert os.sched_getscheduler(0) != os.SCHED_RR


@pytest.mark.skipif(sys.platform != "linux", reason="policies of scheduling are those of Linux")
def test_threads_that_hand_frames_to_each_other_share_a_core_which_others_leave() -> None:
    found: list[tuple[int, int]] = []

    def note() -> None:
        found.append((len(os.sched_getaffinity(0)), os.sched_getparam(0).sched_priority))

    def stray() -> None:
        note()
        leave_frame_core()
        note()

    def camera() -> None:
        with ordinary_priority():
            join_frame_core(Rank.CAMERA)
            note()
        if keep_pace():
            join_frame_core(Rank.CAMERA)
            other = Thread(target=stray)
            other.start()
            other.join()

    cores = len(os.sched_getaffinity(0))
    thread = Thread(target=camera)
    thread.start()
    thread.join()
    if len(found) == 1:
        pytest.skip("this user may not have real-time priority")
    assert found == [(cores, 0), (1, Rank.CAMERA), (cores, Rank.REST)]


@pytest.mark.skipif(sys.platform != "linux", reason="policies of scheduling are those of Linux")
def test_a_limit_below_the_priority_of_the_cameras_threads_is_no_real_time(monkeypatch) -> None:
    """Before: those threads ended when they took their rank, and no frame came."""
    asked: list[int] = []

    def limited(_pid: int, _policy: int, parameters: os.sched_param) -> None:
        if parameters.sched_priority > Rank.REST:
            raise PermissionError
        asked.append(parameters.sched_priority)

    monkeypatch.setattr(os, "sched_setscheduler", limited)
    assert not keep_pace()
    assert not asked


def test_only_young_garbage_is_collected_while_frames_stream() -> None:
    """A full collection stops every thread, the longer the more objects there are."""
    collected: list[int] = []

    def note(phase: str, info: dict[str, int]) -> None:
        if phase == "start":
            collected.append(info["generation"])

    before = gc.get_threshold()
    settle_memory()
    gc.collect()  # no object is old now: new ones of a quarter of the old make a full collection
    try:
        gc.set_threshold(10, 2, 2)
        with full_collections_deferred():
            gc.callbacks.append(note)
            kept = [[k] for k in range(5000)]
            gc.callbacks.remove(note)
        assert set(collected) == {0, 1}
        assert gc.get_threshold() == (10, 2, 2)
    finally:
        gc.set_threshold(*before)
        gc.unfreeze()
    assert len(kept) == 5000
