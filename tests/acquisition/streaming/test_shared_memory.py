from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from threading import Thread

import numpy as np
import pytest

from napari_elsplus.acquisition.streaming import shared_memory as shared
from napari_elsplus.acquisition.streaming.ring import Layout
from napari_elsplus.hardware.protocols import FrameInfo

ATTACH = """
import sys
from napari_elsplus.acquisition.streaming import shared_memory as shared
segment = shared.attach(sys.argv[1])
print(bytes(segment.buf[:3]))
segment.close()
"""
ORPHAN = """
import os, signal
from multiprocessing import resource_tracker
from napari_elsplus.acquisition.streaming import shared_memory as shared
segment = shared.create(64)
resource_tracker.unregister("/" + segment.name, "shared_memory")  # as if the tracker had been killed too
print(segment.name, flush=True)
os.kill(os.getpid(), signal.SIGKILL)
"""


def run(code: str, *arguments: str) -> str:
    done = subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True, timeout=60)
    assert not done.stderr, done.stderr
    return done.stdout.strip()


def test_a_segment_outlives_the_processes_that_look_into_it() -> None:
    segment = shared.create(64)
    try:
        segment.buf[:3] = b"els"
        for _ in range(2):
            assert run(ATTACH, segment.name) == "b'els'"
    finally:
        segment.close()
        segment.unlink()
    with pytest.raises(FileNotFoundError):
        shared.attach(segment.name)


@pytest.mark.skipif(not Path("/dev/shm").is_dir(), reason="segments are listed on Linux only")
def test_what_a_killed_owner_left_is_swept_and_nothing_else() -> None:
    mine = shared.create(64)
    try:
        orphan = run(ORPHAN)
        assert Path("/dev/shm", orphan).exists()
        assert orphan in shared.sweep()
        assert not Path("/dev/shm", orphan).exists()
        assert Path("/dev/shm", mine.name).exists()
    finally:
        mine.close()
        mine.unlink()


@pytest.mark.skipif(not Path("/dev/shm").is_dir(), reason="segments are listed on Linux only")
def test_a_segment_of_a_live_owner_is_never_swept_whatever_its_process_id_is_here() -> None:
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    mine = shared.create(64, f"elsplus-{ended.pid}-0123abcd")  # as of a process in another container
    try:
        assert mine.name not in shared.sweep()
        assert Path("/dev/shm", mine.name).exists()
    finally:
        mine.close()
        mine.unlink()


@pytest.mark.skipif(not Path("/dev/shm").is_dir(), reason="reserved on Linux only")
def test_memory_is_reserved_when_a_segment_is_made() -> None:
    mine = shared.create(8 << 20)
    try:
        assert Path("/dev/shm", mine.name).stat().st_blocks * 512 >= 8 << 20
    finally:
        mine.close()
        mine.unlink()


def test_a_ring_is_closed_only_when_nobody_copies_from_it() -> None:
    layout = Layout(slots=3, fields=(("raw", (1500, 1500), "uint8"),))
    owner = shared.SharedRing.create(layout)
    try:
        owner.finalize(owner.acquire(), FrameInfo(0, 0.0, 0.0))
        for _ in range(50):
            reader = shared.SharedRing.attach(owner.name, layout)
            out = {"raw": np.empty((1500, 1500), np.uint8)}
            copying = Thread(target=lambda reader=reader, out=out: [reader.newest_after(-1, out) for _ in range(20)])
            copying.start()
            reader.close()
            copying.join()
            assert reader.newest_after(-1, out) is None
    finally:
        owner.close()
