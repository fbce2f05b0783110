"""Recording formats: what a frame costs, and how many frames are lost when the program is killed before it closes.

The file is copied as it lies on the disk while it is still open: what the program holds back is not in the copy.
"""

from __future__ import annotations

import shutil
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np
import tifffile
import zarr

from benchmarks.harness.methods import Benchmark, Case, Judgement, Method, Role, TimedElsewhere
from napari_elsplus.errors import ElsPlusError
from napari_elsplus.io import RecordingWriter, open_recording

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Frame = NDArray[np.uint8]

_SHAPE = (524, 1328)


class Writer(Protocol):
    """Takes frames one by one."""

    def append(self, frame: Frame, index: int) -> None:
        """Write a frame."""

    def close(self) -> None:
        """Finish the file."""


class Left(NamedTuple):
    """Share of the frames that a copy of the unfinished file does not give back, and the finished file's size."""

    lost: float
    bytes_a_frame: float


class _Ours:
    def __init__(self, path: Path, count: int) -> None:
        self._writer = RecordingWriter(path, _SHAPE, np.uint8)

    def append(self, frame: Frame, index: int) -> None:
        self._writer.append(frame, index / 240, index)

    def close(self) -> None:
        self._writer.close()


class _Tiff:
    def __init__(self, path: Path, **options: Any) -> None:
        self._writer = tifffile.TiffWriter(path, bigtiff=True)
        self._options = options

    def append(self, frame: Frame, index: int) -> None:
        self._writer.write(frame, photometric="minisblack", **self._options)

    def close(self) -> None:
        self._writer.close()


class _Npy:
    def __init__(self, path: Path, count: int) -> None:
        self._array = np.lib.format.open_memmap(path, "w+", np.uint8, (count, *_SHAPE))

    def append(self, frame: Frame, index: int) -> None:
        self._array[index] = frame

    def close(self) -> None:
        self._array.flush()


class _Zarr:
    def __init__(self, path: Path, count: int) -> None:
        self._array: Any = zarr.create_array(path, shape=(count, *_SHAPE), chunks=(1, *_SHAPE), dtype="uint8")

    def append(self, frame: Frame, index: int) -> None:
        self._array[index] = frame

    def close(self) -> None:
        pass


def _cases(quick: bool) -> list[Case]:
    count = 4 if quick else 120
    random = np.random.default_rng(0)
    frames = np.clip(random.poisson(20, (4, *_SHAPE)), 0, 255).astype(np.uint8)
    return [Case("524 x 1328, 8 bit", [[frames[k % 4] for k in range(count)]], calls=count)]


def _writing(
    suffix: str, make: Callable[[Path, int], Writer]
) -> Callable[[Case], Callable[[list[Frame]], TimedElsewhere]]:
    def write(frames: list[Frame]) -> TimedElsewhere:
        with TemporaryDirectory() as folder:
            path, copy = Path(folder, f"whole{suffix}"), Path(folder, f"killed{suffix}")
            start = perf_counter()
            writer = make(path, len(frames))
            for index, frame in enumerate(frames):
                writer.append(frame, index)
            seconds = perf_counter() - start
            (shutil.copytree if path.is_dir() else shutil.copyfile)(path, copy)
            start = perf_counter()
            writer.close()
            seconds += perf_counter() - start
            size = sum(file.stat().st_size for file in (path.rglob("*") if path.is_dir() else [path]))
            return TimedElsewhere(Left(_lost(copy, frames), size / len(frames)), seconds)

    return lambda _: write


def _lost(path: Path, frames: list[Frame]) -> float:
    """Share of the frames that cannot be read from a file, with whatever reads it."""
    kept = 0
    try:
        if path.suffix == ".zarr":
            array: Any = zarr.open_array(path, mode="r")
            kept = sum(np.array_equal(array[k], frame) for k, frame in enumerate(frames))
        else:
            with open_recording(path) as recording:
                kept = sum(np.array_equal(a, b) for a, b in zip(recording, frames, strict=False))
    except ElsPlusError:
        kept = 0
    return 1 - kept / len(frames)


def judge(_: list[Frame], answer: Left) -> Judgement:
    """Percent of the frames that a kill takes away."""
    return Judgement(100 * answer.lost, failed=answer.lost > 0, details={"MB a frame": answer.bytes_a_frame / 1e6})


METHODS = (
    Method("RecordingWriter", Role.DEFAULT, _writing(".ome.tif", _Ours)),
    Method("tifffile, a page each", Role.OPTION,
           _writing(".tif", lambda path, _: _Tiff(path, contiguous=False, metadata=None))),
    Method("tifffile, contiguous", Role.OPTION, _writing(".tif", lambda path, _: _Tiff(path, contiguous=True))),
    Method("tifffile, zlib", Role.OPTION,
           _writing(".tif", lambda path, _: _Tiff(path, contiguous=False, metadata=None, compression="zlib"))),
    Method("numpy, mapped", Role.OPTION, _writing(".npy", _Npy)),
    Method("zarr, a chunk each", Role.OPTION, _writing(".zarr", _Zarr)),
)  # fmt: skip

BENCHMARK = Benchmark(
    name="recording",
    question="How raw frames are recorded",
    error_label="frames lost to a kill / %",
    cases=_cases,
    methods=METHODS,
    judge=judge,
    waits=True,
    seconds=1.0,
    remarks=(
        "Time for each frame, opening and closing included, on this machine's temporary folder; 240 frames per second "
        "leave 4167 us. A mapped file and zarr need the number of frames beforehand, and keep no times."
    ),
)
