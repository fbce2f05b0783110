from __future__ import annotations

from threading import Event, Thread

import numpy as np
import pytest

from napari_elsplus.acquisition.streaming.ring import Layout, Ring, Slot
from napari_elsplus.hardware.protocols import FrameInfo

LAYOUT = Layout(slots=4, fields=(("raw", (30, 40), "uint8"), ("els", (20, 20), "float32")))


def write(ring: Ring, value: int) -> Slot:
    slot = ring.acquire()
    slot.arrays["raw"][...] = value
    slot.arrays["els"][...] = value
    ring.finalize(slot, FrameInfo(10 + value, value / 240, value / 240))
    return slot


def test_a_reader_gets_the_newest_frame_once() -> None:
    memory = bytearray(LAYOUT.nbytes)
    writer, reader = Ring(memory, LAYOUT), Ring(memory, LAYOUT)
    out = {"els": np.empty((20, 20), np.float32)}
    assert reader.newest_after(-1, out) is None
    for value in range(7):
        write(writer, value)
    stamp = reader.newest_after(-1, out)
    assert stamp is not None
    assert (stamp.sequence, stamp.frame_number) == (6, 16)
    assert (out["els"] == 6).all()
    assert reader.newest_after(6, out) is None


def test_a_frame_being_written_is_not_shown() -> None:
    ring = Ring(bytearray(LAYOUT.nbytes), LAYOUT)
    write(ring, 0)
    slot = ring.acquire()
    slot.arrays["raw"][...] = 99
    out = {"raw": np.empty((30, 40), np.uint8)}
    stamp = ring.newest_after(-1, out)
    assert stamp is not None
    assert stamp.sequence == 0
    assert (out["raw"] == 0).all()


def test_an_overwritten_frame_has_no_stamp() -> None:
    ring = Ring(bytearray(LAYOUT.nbytes), LAYOUT)
    for value in range(6):
        write(ring, value)
    assert [ring.stamp(k) is not None for k in range(6)] == [False, False, True, True, True, True]


def test_fields_do_not_overlap() -> None:
    ring = Ring(bytearray(LAYOUT.nbytes), LAYOUT)
    slots = [write(ring, value) for value in range(4)]
    for value, slot in enumerate(slots):
        assert (slot.arrays["raw"] == value).all()
        assert (slot.arrays["els"] == value).all()


def test_a_reader_never_sees_pieces_of_two_frames() -> None:
    """The writer is as fast as it can be; every copy that is handed out is of one frame."""
    layout = Layout(slots=3, fields=(("raw", (200, 300), "uint8"),))
    memory = bytearray(layout.nbytes)
    writer, reader = Ring(memory, layout), Ring(memory, layout)
    done = Event()

    def run() -> None:
        k = 0
        while not done.is_set():
            slot = writer.acquire()
            slot.arrays["raw"][...] = k % 251
            writer.finalize(slot, FrameInfo(k, 0.0, 0.0))
            k += 1

    thread = Thread(target=run)
    thread.start()
    try:
        out, seen = {"raw": np.empty((200, 300), np.uint8)}, -1
        looked = 0
        while looked < 60:
            stamp = reader.newest_after(seen, out)
            if stamp is None:
                continue
            assert stamp.sequence > seen
            assert out["raw"].min() == out["raw"].max() == stamp.frame_number % 251
            seen, looked = stamp.sequence, looked + 1
    finally:
        done.set()
        thread.join()


def test_a_ring_of_one_slot_is_refused() -> None:
    with pytest.raises(ValueError, match="1 slots"):
        Layout(slots=1, fields=())
