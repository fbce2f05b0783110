"""Recordings of any format as one lazy sequence of raw frames."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload
from weakref import finalize

import numpy as np

from napari_elsplus.closing import ClosedOnExit
from napari_elsplus.errors import InputError
from napari_elsplus.instrument.arguments import require_path
from napari_elsplus.io.calibration_lookup import find_calibration
from napari_elsplus.io.formats.registry import format_to_read
from napari_elsplus.io.formats.source import FrameSource, decoding

if TYPE_CHECKING:
    import os
    from collections.abc import Iterator

    from numpy.typing import DTypeLike, NDArray

    from napari_elsplus.instrument.calibration import Calibration


class Recording(ClosedOnExit):
    """Raw frames on disk, read when they are indexed; safe to index from several threads.

    Parameters
    ----------
    source : FrameSource
        Where the frames come from; use :func:`open_recording`.

    Notes
    -----
    ``recording[k]`` is one frame (rows, cols); ``recording[a:b]`` is a stack (n, rows, cols), all of it in memory.
    Float recordings are read as float32 and each frame is checked for NaN.
    """

    def __init__(self, source: FrameSource) -> None:
        self._source: FrameSource | None = source
        self.path: Path = source.path
        self.shape: tuple[int, int, int] = (source.shape[0], source.shape[1], source.shape[2])
        self.dtype: np.dtype[Any] = source.dtype
        self.metadata: dict[str, Any] = {
            name: value for name, value in source.metadata.items() if name != "calibration"
        }
        self._release = finalize(self, source.close)  # viewers drop recordings without closing them
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
        """Time of each frame in seconds, (T,), or None if the file has none."""
        with decoding(self.path, "the frames' times"):
            return self._open().times_s()

    def camera_times_by(self, calibration: Calibration | None) -> NDArray[np.float64] | None:
        """Return the time of each frame in seconds, (T,), as it was taken; None if the file has none.

        Parameters
        ----------
        calibration : Calibration or None
            Its frame period replaces that of a video's header, at which the video is played back; without one the
            times of a video are unknown.
        """
        if not self.metadata.get("playback"):
            return self.times_s
        period_s = None if calibration is None else calibration.frame_period_s
        return None if period_s is None else self.frame_numbers.astype(np.float64) * period_s

    def times_by(self, calibration: Calibration | None) -> NDArray[np.float64] | None:
        """Return the time of each frame in seconds, (T,), as it was taken by a `calibration`, else as it is played."""
        times_s = self.camera_times_by(calibration)
        return self.times_s if times_s is None else times_s

    @property
    def frame_numbers(self) -> NDArray[np.int64]:
        """The camera's frame numbers, (T,); a gap is a dropped frame."""
        with decoding(self.path, "the frames' numbers"):
            return self._open().frame_numbers()

    @property
    def holds_raw_frames(self) -> bool:
        """True if the file contains a calibration, and no image type: raw frames of this package, not images."""
        return self._calibration_text is not None and self.image_type is None

    @property
    def image_type(self) -> str | None:
        """Image type of images that this package has made of raw frames, ``"els"`` for instance; else None."""
        settings = self.metadata.get("settings")
        mode = settings.get("mode", "raw") if isinstance(settings, dict) else "raw"  # a raw layer is saved with "raw"
        return None if mode == "raw" else str(mode)

    @property
    def calibration(self) -> Calibration | None:
        """Calibration that lies beside the recording (with its background), else the one in it, else None.

        Raises
        ------
        CalibrationError
            If there is one and it is broken.
        """
        return self.find_calibration()[0]

    def find_calibration(self, active: Path | None = None) -> tuple[Calibration | None, Path | None]:
        """Return the calibration to use and its file, if it lies in one: beside the recording, in it, else the active.

        Parameters
        ----------
        active : pathlib.Path, optional
            File of the active calibration, from :func:`napari_elsplus.io.settings.active_calibration`.

        Raises
        ------
        CalibrationError
            If it is broken.
        """
        return find_calibration(self.path, self._calibration_text, active)

    def close(self) -> None:
        """Close the file; frames that were returned stay valid."""
        self._source = None
        self._release()

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
        A recording of this software, any multi-page TIFF (grey, 8 or 16 bit or float), an AVI, a .npy file, an OME-Zarr
        folder, a folder of single TIFFs, or any other registered format. A single image counts as one frame.

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
    require_path(path)
    path = Path(path)
    with decoding(path), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what makes a file unreadable is raised; decoders' warnings do not matter
        opener = format_to_read(path).opener
        assert opener is not None
        source = opener(path)
    for remark in source.remarks:
        warnings.warn(remark, stacklevel=2)
    return Recording(source)
