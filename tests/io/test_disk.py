"""Bytes written past the system's memory are those that were given, at their place, and nothing else is touched."""

from __future__ import annotations

import errno
import mmap
import os
import shutil
from threading import Event
from typing import TYPE_CHECKING

import numpy as np
import pytest

from napari_elsplus.io import disk
from napari_elsplus.io.disk import SpanWriter, require_room

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

PAGE = mmap.PAGESIZE
BLOCK_BYTES = 1 << 20
"""Instead of 16 MB: what counts are the ends of blocks."""
BEFORE = np.random.default_rng(5).integers(0, 256, 3 * BLOCK_BYTES, np.uint8)


@pytest.fixture(autouse=True)
def _small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(disk, "BLOCK_BYTES", BLOCK_BYTES)


def test_a_disk_that_does_not_state_its_size_is_written_to(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: shutil._ntuple_diskusage(0, 0, 0))  # type: ignore[attr-defined]
    require_room(tmp_path / "a.tif", 1e12)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: shutil._ntuple_diskusage(10, 10, 0))  # type: ignore[attr-defined]
    with pytest.raises(OSError, match=r"0.0 MB do not fit"):
        require_room(tmp_path / "a.tif", 1)


def written(path: Path, start: int, arrays: Sequence[NDArray[np.uint8]]) -> None:
    """Write arrays into a file of known bytes and compare the whole file with what it should hold."""
    BEFORE.tofile(path)
    with SpanWriter(path, start) as writer:
        for array in arrays:
            writer.write(array)
    expected = BEFORE.copy()
    new = np.concatenate([array.reshape(-1) for array in arrays]) if arrays else BEFORE[:0]
    expected[start : start + len(new)] = new
    np.testing.assert_array_equal(np.fromfile(path, np.uint8), expected)


@pytest.mark.parametrize("start", [0, 1, PAGE - 1, PAGE, 5 * PAGE + 137])
@pytest.mark.parametrize("size", [0, 1, PAGE - 1, PAGE, BLOCK_BYTES - 137, BLOCK_BYTES, 2 * BLOCK_BYTES + 4097])
def test_a_span_holds_what_was_written_and_its_neighbours_stay(tmp_path: Path, start: int, size: int) -> None:
    random = np.random.default_rng(size + start)
    values = random.integers(0, 256, size, np.uint8)
    written(tmp_path / "a.bin", start, np.array_split(values, 7) if size else [])


def test_images_of_floats_are_written_as_their_bytes(tmp_path: Path) -> None:
    images = np.random.default_rng(1).normal(size=(9, 467, 467)).astype(np.float32)
    path = tmp_path / "a.bin"
    path.write_bytes(bytes(images.nbytes + 300))
    with SpanWriter(path, 300) as writer:
        for image in images:
            writer.write(image)
    np.testing.assert_array_equal(np.fromfile(path, np.float32, offset=300).reshape(images.shape), images)


def test_a_disk_that_refuses_is_written_by_way_of_the_systems_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_at = disk.write_at
    refused = []

    def refusing(file: object, place: int, *parts: bytes | memoryview) -> None:
        if not refused:
            refused.append(place)
            raise OSError(errno.EINVAL, os.strerror(errno.EINVAL))
        write_at(file, place, *parts)  # type: ignore[arg-type]

    monkeypatch.setattr(disk, "write_at", refusing)
    written(tmp_path / "a.bin", 137, [BEFORE[::-1][: BLOCK_BYTES + 99].copy()])
    assert refused


@pytest.mark.parametrize("blocks", [1, 2, 5])
def test_what_could_not_be_written_is_told_though_later_blocks_could(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, blocks: int
) -> None:
    write_at, places = disk.write_at, []

    def full_at_first(file: object, place: int, *parts: bytes | memoryview) -> None:
        places.append(place)
        if len(places) == 1:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        write_at(file, place, *parts)  # type: ignore[arg-type]

    monkeypatch.setattr(disk, "write_at", full_at_first)
    path = tmp_path / "a.bin"
    path.write_bytes(b"")
    with pytest.raises(OSError, match="No space"), SpanWriter(path, 0) as writer:
        writer.write(np.tile(BEFORE[:BLOCK_BYTES], blocks))
    assert places[0] == 0


def test_an_array_may_be_reused_as_soon_as_it_was_given(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """While the disk has taken none of its bytes."""
    write_at, go_on = disk.write_at, Event()

    def late(file: object, place: int, *parts: bytes | memoryview) -> None:
        assert go_on.wait(60)
        write_at(file, place, *parts)  # type: ignore[arg-type]

    monkeypatch.setattr(disk, "write_at", late)
    path = tmp_path / "a.bin"
    path.write_bytes(b"")
    values = np.zeros(BLOCK_BYTES, np.uint8)
    with SpanWriter(path, 0) as writer:
        for number, count in enumerate((BLOCK_BYTES, BLOCK_BYTES // 2)):
            values[:] = number
            writer.write(values[:count])
        values[:] = 99
        go_on.set()
    np.testing.assert_array_equal(np.fromfile(path, np.uint8), np.repeat([0, 1], (BLOCK_BYTES, BLOCK_BYTES // 2)))


def test_systems_without_direct_writing_write_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(os, "O_DIRECT", raising=False)
    written(tmp_path / "a.bin", 10, [BEFORE[::-1][: BLOCK_BYTES + 99].copy()])
