from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from napari_elsplus.acquisition.streaming import shared_memory as shared

ATTACH = """
import sys
from napari_elsplus.acquisition import shared
segment = shared.attach(sys.argv[1])
print(bytes(segment.buf[:3]))
segment.close()
"""
ORPHAN = """
import os, signal
from multiprocessing import resource_tracker
from napari_elsplus.acquisition import shared
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
