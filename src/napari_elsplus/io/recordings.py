"""Recordings of any format as one lazy sequence of raw frames."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, overload
from weakref import finalize

import numpy as np

from napari_elsplus.errors import CalibrationError, InputError
from napari_elsplus.io.calibrations import calibration_beside, parse_calibration, read_calibration
from napari_elsplus.io.formats.source import FrameSource, decoding

if TYPE_CHECKING:
    import os
    from collections.abc import Iterator

    from numpy.typing import DTypeLike, NDArray

    from napari_elsplus.instrument.calibration import Calibration

_ZARR_MARKS = ("zarr.json", ".zgroup", ".zarray", ".zattrs")


class Recording:
    """Raw frames on disk, read when they are asked for; safe to index from several threads.

    Parameters
    ----------
    source : FrameSource
        Where the frames come from; use :func:`open_recording`.

    Notes
    -----
    ``recording[k]`` is one frame (rows, cols); ``recording[a:b]`` is a stack (n, rows, cols). Both may be read-only
    views of the file. Float recordings are read as float32 and each frame is checked for NaN.
    """

    def __init__(self, source: FrameSource) -> None:
        self._source: FrameSource | None = source
        self.path: Path = source.path
        self.shape: tuple[int, int, int] = (source.shape[0], source.shape[1], source.shape[2])
        self.dtype: np.dtype[Any] = source.dtype
        self.metadata: dict[str, Any] = {
            name: value for name, value in source.metadata.items() if name not in {"calibration", "times_s"}
        }
        self._let_go = finalize(self, source.close)  # a viewer drops its recordings without a word
        self._calibration_text: str | None = source.metadata.get("calibration")

    def __len__(self) -> int:
        return self.shape[0]

    @property
    def ndim(self) -> int:
        """Three: time, rows, columns."""
        return 3

    @overload
    def __getitem__(self, index: int | np.integer[Any]) -> NDArray[Any]: ...
    @overload
    def __getitem__(self, index: slice) -> NDArray[Any]: ...
    def __getitem__(self, index: int | np.integer[Any] | slice) -> NDArray[Any]:
        """Read a frame (rows, cols) or, for a slice, a stack (n, rows, cols)."""
        if isinstance(index, slice):
            with decoding(self.path, "a frame"):
                return self._open().block(range(*index.indices(len(self))))
        frame = int(index)
        if not -len(self) <= frame < len(self):
            raise IndexError(f"frame {frame} of {len(self)}")
        return self._open().checked(frame % len(self))

    def __iter__(self) -> Iterator[NDArray[Any]]:
        return (self[index] for index in range(len(self)))

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[Any]:
        return np.array(self[:], dtype=dtype, copy=copy)

    @property
    def times_s(self) -> NDArray[np.float64] | None:
        """Time of each frame in seconds, (T,), or None where the file does not know it."""
        with decoding(self.path, "the frames' times"):
            return self._open().times_s()

    @property
    def frame_numbers(self) -> NDArray[np.int64]:
        """The camera's frame numbers, (T,); a gap is a dropped frame."""
        with decoding(self.path, "the frames' numbers"):
            return self._open().frame_numbers()

    @property
    def calibration(self) -> Calibration | None:
        """Calibration that lies beside the recording (with its background), else the one in it, else None.

        Raises
        ------
        CalibrationError
            If there is one and it is broken.
        """
        beside = calibration_beside(self.path)
        if beside is not None:
            return read_calibration(beside)
        if self._calibration_text is None:
            return None
        try:
            return parse_calibration(self._calibration_text, name=self.path.name)
        except CalibrationError as error:
            raise CalibrationError(f"calibration in {error.problem}", "name another with -c") from None

    def close(self) -> None:
        """Let go of the file; views that were handed out stay valid."""
        self._source = None
        self._let_go()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        count, rows, cols = self.shape
        return f"<Recording {self.path.name}: {count} frames of {rows} x {cols}, {self.dtype}>"

    def _open(self) -> FrameSource:
        if self._source is None:
            raise InputError(f"{self.path.name} is closed", "open it again")
        return self._source


def open_recording(path: str | os.PathLike[str]) -> Recording:
    """Open a recording without loading it.

    Parameters
    ----------
    path : path-like
        One of our own recordings, any multi-page TIFF (grey, 8 or 16 bit or float), an AVI, a .npy file, an OME-Zarr
        folder, or a folder of single TIFFs. A single image counts as one frame.

    Returns
    -------
    Recording
        A lazy sequence of raw frames; use it as a context manager.

    Raises
    ------
    InputError
        If it is missing, empty, truncated, in colour, of other dimensions, or no recording at all.

    Examples
    --------
    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp()) / "dark.npy"
    >>> np.save(path, np.zeros((5, 40, 60), np.uint8))
    >>> with open_recording(path) as recording:
    ...     recording
    <Recording dark.npy: 5 frames of 40 x 60, uint8>
    """
    path = Path(path)
    with decoding(path), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # whatever a reader remarks of a file that it opens is told, or is no matter
        return Recording(_source(path))


def _source(path: Path) -> FrameSource:
    if path.is_dir():
        if any((path / mark).is_file() for mark in _ZARR_MARKS):
            from napari_elsplus.io.formats.arrays import OmeZarr

            return OmeZarr(path)
        from napari_elsplus.io.formats.tiff_folder import FolderOfTiffs

        return FolderOfTiffs(path)
    suffix = path.suffix.lower()
    path.stat()  # a missing file is told before its kind
    if suffix == ".avi":
        from napari_elsplus.io.formats.avi import open_video

        return open_video(path)
    if suffix == ".npy":
        from napari_elsplus.io.formats.arrays import NumpyFile

        return NumpyFile(path)
    from napari_elsplus.io.formats.tiff import open_tiff

    return open_tiff(path)
