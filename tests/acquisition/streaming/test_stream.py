from __future__ import annotations

import sys
from threading import Thread
from time import sleep

import pytest

from napari_elsplus.acquisition.streaming.stream import FrameStream
from napari_elsplus.hardware.protocols import FrameInfo

SHAPE = (4, 6)


def put(stream: FrameStream, count: int) -> None:
    """Write frames as the camera's thread does."""
    for _ in range(count):
        slot = stream.acquire()
        slot.arrays["raw"][...] = slot.sequence
        stream.finalize(slot, FrameInfo(slot.sequence, slot.sequence / 240, 0.0))


def numbers(stream: FrameStream, cursor: object) -> list[int]:
    taken = []
    while (item := cursor.take(0)) is not None:  # type: ignore[attr-defined]
        frame, stamp = item
        assert (frame == stamp.frame_number % 256).all()
        taken.append(stamp.frame_number)
    return taken


def test_every_consumer_gets_every_frame() -> None:
    stream = FrameStream(SHAPE, 8)
    first, second = stream.join(), stream.join()
    put(stream, 5)
    assert numbers(stream, first) == numbers(stream, second) == [0, 1, 2, 3, 4]
    assert (first.skipped, second.skipped) == (0, 0)


def test_a_slow_consumer_loses_the_oldest_frames_and_knows_how_many() -> None:
    stream = FrameStream(SHAPE, 8)
    slow, patient = stream.join(limit=3), stream.join()
    put(stream, 7)
    assert numbers(stream, slow) == [4, 5, 6]
    assert slow.skipped == 4
    assert numbers(stream, patient) == list(range(7))
    assert patient.skipped == 0


def test_a_frame_that_is_worked_on_is_never_overwritten() -> None:
    stream = FrameStream(SHAPE, 4)
    cursor = stream.join()
    put(stream, 1)
    frame, _ = cursor.take(0)  # type: ignore[misc]
    put(stream, 10)
    assert (frame == 0).all()
    assert numbers(stream, cursor) == [10, 11, 13]  # the held slot is passed over: there is no frame 4, 8, 12
    assert cursor.skipped == 7


def test_the_past_is_there_for_a_consumer_that_comes_late() -> None:
    stream = FrameStream(SHAPE, 8)
    put(stream, 20)
    assert numbers(stream, stream.join(earlier=3)) == [17, 18, 19]
    assert numbers(stream, stream.join(earlier=100)) == [14, 15, 16, 17, 18, 19]
    assert numbers(stream, stream.join()) == []


def test_consumers_read_what_is_left_when_the_stream_has_ended() -> None:
    stream = FrameStream(SHAPE, 8)
    cursor = stream.join()
    put(stream, 2)
    stream.end()
    assert numbers(stream, cursor) == [0, 1]
    assert cursor.take(60) is None


def test_a_waiting_consumer_is_woken_by_a_frame() -> None:
    stream = FrameStream(SHAPE, 8)
    cursor = stream.join()
    got: list[int] = []

    def wait() -> None:
        item = cursor.take(60)
        assert item is not None
        got.append(item[1].frame_number)

    thread = Thread(target=wait)
    thread.start()
    put(stream, 1)
    thread.join(10)
    assert got == [0]


def test_a_consumer_of_batches_is_woken_once_for_each() -> None:
    stream = FrameStream(SHAPE, 8)
    cursor = stream.join(batch=3)
    woken: list[int] = []

    def wait() -> None:
        while cursor.take(60) is not None:
            woken.append(stream.written)
            while cursor.behind and cursor.take(0) is not None:
                pass

    thread = Thread(target=wait)
    thread.start()
    for _ in range(2):
        while cursor.awaited is None:
            sleep(1e-4)
        put(stream, 2)
        assert cursor.awaited is not None
        put(stream, 1)
    while cursor.awaited is None:
        sleep(1e-4)
    put(stream, 1)
    stream.end()
    thread.join(10)
    assert woken == [3, 6, 7]


def test_an_incomplete_batch_is_taken_when_the_time_is_up() -> None:
    stream = FrameStream(SHAPE, 8)
    cursor = stream.join(batch=3)
    put(stream, 1)
    assert numbers(stream, cursor) == [0]
    put(stream, 1)
    assert numbers(stream, cursor) == [1]


def test_a_consumer_that_left_holds_nothing_up() -> None:
    stream = FrameStream(SHAPE, 4)
    cursor = stream.join()
    put(stream, 1)
    cursor.take(0)
    cursor.close()
    put(stream, 20)
    assert numbers(stream, stream.join(earlier=9)) == [19, 20]


def test_stamps_carry_the_camera_s_number_and_time() -> None:
    stream = FrameStream(SHAPE, 4)
    cursor = stream.join()
    slot = stream.acquire()
    stream.finalize(slot, FrameInfo(71, 3.5, 1.5))
    _, stamp = cursor.take(0)  # type: ignore[misc]
    assert (stamp.sequence, stamp.frame_number, stamp.received_s) == (0, 71, 3.5)
    assert stamp.readout_start_s == 1.5


@pytest.mark.skipif(sys.platform != "linux", reason="counts page faults as Linux does")
def test_no_page_of_the_ring_is_first_touched_while_the_camera_runs() -> None:
    import resource

    stream = FrameStream((512, 1024), 40)  # 5120 pages
    before = resource.getrusage(resource.RUSAGE_THREAD).ru_minflt
    put(stream, 40)
    assert resource.getrusage(resource.RUSAGE_THREAD).ru_minflt - before < 500
