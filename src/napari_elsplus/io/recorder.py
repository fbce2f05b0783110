"""Crash-safe recording: every frame is a whole page of a BigTIFF as soon as it is written."""

from __future__ import annotations

import ctypes
import os
import sys
import time
from contextlib import suppress
from functools import cache
from pathlib import Path
from threading import Event, Thread
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from napari_elsplus.closing import ClosedOnExit
from napari_elsplus.errors import InputError
from napari_elsplus.io.atomic import refuse_existing, refuse_suffix
from napari_elsplus.io.calibration_lookup import beside
from napari_elsplus.io.calibrations import write_calibration
from napari_elsplus.io.disk import write_at
from napari_elsplus.io.formats import ome_xml as ome
from napari_elsplus.io.formats.registry import ImageMetadata
from napari_elsplus.io.formats.tiff import TIFF
from napari_elsplus.io.formats.tiff_pages import PageLayout
from napari_elsplus.io.frame_times import median_period_s

if TYPE_CHECKING:
    import io
    from collections.abc import Callable, Mapping

    from numpy.typing import DTypeLike, NDArray

    from napari_elsplus.instrument.calibration import Calibration

FLUSH_PERIOD_S: Final = 1.0
"""Maximum loss at a power cut. Chosen: part of the contract of recordings; a flush each second costs no frame."""
RESERVED_BYTES: Final = 64 << 20
"""Disk space that is reserved at once, bytes; chosen: a fraction of a second of frames. A frame of 524 x 1328 then
takes 120 us to write instead of 170, processor time."""
RECORDING_SUFFIXES: Final = (*TIFF.written_suffixes, ".btf")
"""Suffixes of recordings, which are BigTIFF."""
_KEEP_SIZE: Final = 1
"""Flag of Linux' ``fallocate`` (linux/falloc.h): what is reserved lies beyond the end of the file."""


class RecordingWriter(ClosedOnExit):
    """Write raw frames to a file that a crash leaves readable up to its last whole frame.

    Each frame becomes one uncompressed page of a BigTIFF, all of the same length, with its time and number in a
    private tag. The file is flushed to the disk each second. After a kill all whole pages open; after a power cut,
    those of the last flush. OME-XML is put into the first page when the recording is closed. What is flushed leaves the
    system's memory, which would otherwise fill up with a file that nobody reads yet.

    Parameters
    ----------
    path : path-like
        The recording, NAME.ome.tif.
    frame_shape : tuple of int
        Rows and columns of a raw frame.
    dtype : dtype-like
        uint8 or uint16.
    calibration : Calibration, optional
        Active while recording; written beside, NAME.calibration.json, before the first frame. Without one there is
        no such file beside the recording either, which would be read as its own.
    settings : mapping, optional
        The rig's settings, kept in the OME-XML.
    force : bool
        Replace existing files instead of refusing them.

    Raises
    ------
    InputError
        If either file exists and `force` is not given, the suffix is not one of :data:`RECORDING_SUFFIXES`, or the
        frames are not uint8 or uint16.

    Examples
    --------
    >>> import tempfile
    >>> from napari_elsplus.io import open_recording
    >>> path = Path(tempfile.mkdtemp()) / "still.ome.tif"
    >>> with RecordingWriter(path, (40, 60), np.uint8) as writer:
    ...     for k in range(3):
    ...         writer.append(np.full((40, 60), k, np.uint8), time_s=k / 240, frame_number=k)
    >>> with open_recording(path) as recording:
    ...     recording.shape, int(recording[2].max()), recording.frame_numbers.tolist()
    ((3, 40, 60), 2, [0, 1, 2])
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        frame_shape: tuple[int, int],
        dtype: DTypeLike,
        *,
        calibration: Calibration | None = None,
        settings: Mapping[str, Any] | None = None,
        force: bool = False,
    ) -> None:
        self.path = Path(path)
        self.frame_shape = (int(frame_shape[0]), int(frame_shape[1]))
        self.dtype = np.dtype(dtype)
        if self.dtype not in (np.uint8, np.uint16) or min(self.frame_shape) < 1:
            raise InputError(f"frames of {self.frame_shape}, {self.dtype}", "raw frames are uint8 or uint16, not empty")
        refuse_suffix(self.path, *RECORDING_SUFFIXES)
        self._calibration, self._settings = calibration, dict(settings or {})
        self._files = self.path, *(beside(self.path, f".calibration{ending}") for ending in (".json", ".npz"))
        for file in self._files:
            refuse_existing(file, force=force)
        if calibration is None:
            self._remove()
        else:  # first: where it cannot be written, an earlier recording stays as it was
            write_calibration(self._files[1], calibration, force=force)
            self.path.unlink(missing_ok=True)
        self._times_s: list[float] = []
        self._frame_numbers: list[int] = []
        self._layout = PageLayout(self.frame_shape, self.dtype)
        self._file: io.FileIO | None = self.path.open("xb", buffering=0)
        self._reserved = 0
        self._flush_failed: OSError | None = None
        self._stop = Event()
        self._flusher = Thread(target=self._flush_each_second, name="recording-flush", daemon=True)
        self._flusher.start()

    def __len__(self) -> int:
        return len(self._times_s)

    @property
    def closed(self) -> bool:
        """True once the recording has ended, by :meth:`close` or by a failure of the disk."""
        return self._file is None

    def append(self, frame: NDArray[Any], time_s: float, frame_number: int) -> None:
        """Write one frame; the caller's buffer may be reused as soon as this returns.

        Parameters
        ----------
        frame : numpy.ndarray, (rows, cols)
            Raw frame.
        time_s : float
            When it was taken, in seconds on any one clock.
        frame_number : int
            The camera's number.

        Raises
        ------
        InputError
            If the frame is of another shape or type, or the recording has ended.
        OSError
            If the disk is full or fails: raised once, the recording has then ended with all whole frames in it.
        """
        if self._file is None:
            raise InputError(f"{self.path.name} has ended after {len(self)} frames", "start another recording")
        if frame.shape != self.frame_shape or frame.dtype != self.dtype:
            raise InputError(
                f"frame {frame_number} is {frame.shape}, {frame.dtype}",
                f"this recording takes {self.frame_shape}, {self.dtype}",
            )
        index = len(self)
        try:
            if self._flush_failed is not None:
                raise self._flush_failed
            self._reserve(self._layout.start(index + 1))
            head, pixels = self._layout.head(index, time_s, frame_number), np.ascontiguousarray(frame).data
            write_at(self._file, self._layout.start(index), head, pixels, self._layout.padding)
            write_at(self._file, *self._layout.link(index))  # only now: the page is complete
        except OSError as error:
            self._close_file()
            if not index:
                self._remove()
            raise OSError(
                error.errno, f"the recording ended after {index} frames ({error.strerror})", str(self.path)
            ) from error
        self._times_s.append(float(time_s))
        self._frame_numbers.append(int(frame_number))

    def close(self) -> None:
        """End the recording: put the OME-XML into its first page and flush it to the disk."""
        if self._file is None:
            return
        self._close_file()
        if not self._times_s:
            self._remove()
            return
        try:
            ome.put_into_first_page(self.path, (len(self), *self.frame_shape), self.dtype, self._metadata())
            self._flush()
        except OSError:
            with suppress(FileNotFoundError):
                os.truncate(self.path, self._layout.start(len(self)))
            raise
        if (failed := self._flush_failed) is not None:  # a system tells of a write that was lost only once
            problem = f"some of the recording may not have reached the disk ({failed.strerror})"
            raise OSError(failed.errno, problem, str(self.path)) from failed

    def _metadata(self) -> ImageMetadata:
        return ImageMetadata(
            frame_period_s=median_period_s(self._times_s, self._frame_numbers),
            times_s=tuple(self._times_s),
            settings=self._settings,
            calibration=self._calibration,
        )

    def _close_file(self) -> None:
        file, self._file = self._file, None
        self._stop.set()
        self._flusher.join()
        if file is not None:
            with suppress(OSError):
                file.truncate(self._layout.start(len(self)))  # whole pages; gives back what is reserved
            file.close()

    def _reserve(self, end: int) -> None:
        """Reserve disk space up to a byte offset where the system can; else the disk finds it page by page."""
        fallocate = _fallocate()
        if end > self._reserved and fallocate is not None and self._file is not None:
            fallocate(self._file.fileno(), _KEEP_SIZE, self._reserved, RESERVED_BYTES)
            self._reserved += RESERVED_BYTES

    def _remove(self) -> None:
        for file in self._files:
            file.unlink(missing_ok=True)

    def _flush_each_second(self) -> None:
        due = time.monotonic() + FLUSH_PERIOD_S
        while not self._stop.wait(max(0.0, due - time.monotonic())):
            try:
                self._flush()
            except OSError as error:  # raised by whoever appends next
                self._flush_failed = error
                return
            due = time.monotonic() + FLUSH_PERIOD_S

    def _flush(self) -> None:
        linked = self._layout.start(max(0, len(self) - 1))  # the newest page is changed once more, by its link
        descriptor = os.open(self.path, os.O_RDWR)
        try:
            os.fsync(descriptor)
            if sys.platform == "linux":
                os.posix_fadvise(descriptor, 0, linked, os.POSIX_FADV_DONTNEED)
        finally:
            os.close(descriptor)


@cache
def _fallocate() -> Callable[[int, int, int, int], int] | None:
    """Return Linux' ``fallocate``, of which Python has only the part that makes files longer; None elsewhere."""
    function = None
    if sys.platform == "linux":
        function = ctypes.CDLL(None).fallocate
        function.argtypes = (ctypes.c_int, ctypes.c_int, ctypes.c_int64, ctypes.c_int64)
    return function
