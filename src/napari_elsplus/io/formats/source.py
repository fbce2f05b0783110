"""The interface of a format of recordings: random access to frames, their times, and metadata."""

from __future__ import annotations

from abc import ABC, abstractmethod
from contextlib import contextmanager
from math import isfinite
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from napari_elsplus.errors import ElsPlusError, InputError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

MAX_FRAME_BYTES: Final = 1 << 30
"""Chosen: fifty times a frame of a 20-megapixel camera; a header that declares more is refused as damaged or forged."""

MAX_FRAMES: Final = 10_000_000
"""Chosen: eleven hours at 240 Hz; what is kept for each frame, as its time, fills no memory."""
MAX_LEVEL: Final = 1e9
"""Chosen: thousands of times what cameras deliver, of which sums of squares are finite as float32."""


class FrameSource(ABC):
    """Frames of one format, read one at a time and from any thread.

    Parameters
    ----------
    path : pathlib.Path
        File or folder.
    shape : tuple of int
        (T, rows, cols).
    dtype : numpy.dtype
        uint8, uint16 or float; floats are returned as float32.
    metadata : dict, optional
        What the file contains of ``um_per_px``, ``frame_period_s``, ``times_s`` (a value per frame, None where there is
        none), ``settings`` (a dict), ``software`` and ``calibration`` (JSON text); ``playback``, True if the period is
        that of playing the file back and not that of the camera.

    Attributes
    ----------
    remarks : list of str
        What is wrong with the file although its frames can be read; :func:`napari_elsplus.io.open_recording` warns.

    Raises
    ------
    InputError
        If there is no frame, or the frames are of no use as raw data.
    """

    def __init__(
        self, path: Path, shape: tuple[int, ...], dtype: np.dtype[Any], metadata: dict[str, Any] | None = None
    ) -> None:
        if len(shape) == 2:
            shape = (1, *shape)
        if len(shape) != 3 or 0 in shape:
            raise InputError(f"{path.name} has shape {shape}", "a stack of frames (T, rows, cols) is expected")
        if dtype.kind != "f" and dtype.newbyteorder("=") not in (np.uint8, np.uint16):
            raise InputError(f"{path.name} holds {dtype} pixels", "save it with 8 or 16 bits, unsigned, or as float")
        frame_bytes = shape[1] * shape[2] * dtype.itemsize
        if frame_bytes > MAX_FRAME_BYTES:
            raise InputError(f"{path.name} declares frames of {shape[1]} x {shape[2]} pixels", "the file is damaged")
        if shape[0] > MAX_FRAMES:
            raise InputError(f"{path.name} declares {shape[0]} frames", f"at most {MAX_FRAMES} are read: split it")
        self.path = path
        self.shape = shape
        self.stored_dtype = dtype
        self.dtype = np.dtype(np.float32) if dtype.kind == "f" else dtype.newbyteorder("=")
        self.metadata: dict[str, Any] = metadata or {}
        self.remarks: list[str] = []
        self._times_s = self._usable_times_s(self.metadata.pop("times_s", None) or ())

    @abstractmethod
    def frame(self, index: int) -> NDArray[Any]:
        """Return frame `index`, (rows, cols), as stored; called from any thread."""

    def block(self, indices: range) -> NDArray[Any]:
        """Return the frames of a range of indices, (len(indices), rows, cols)."""
        out = np.empty((len(indices), *self.shape[1:]), self.dtype)
        for image, index in zip(out, indices, strict=True):
            image[:] = self.checked(index)
        return out

    def checked(self, index: int) -> NDArray[Any]:
        """Return frame `index`, (rows, cols), in :attr:`dtype`.

        Raises
        ------
        InputError
            If it cannot be decoded, differs in shape from the others, or holds NaN, infinity or impossible grey levels.
        """
        with decoding(self.path, f"frame {index}"):
            image = self.frame(index)
            if image.shape != self.shape[1:]:
                raise InputError(
                    f"{self.path.name}: frame {index} has shape {image.shape}, the others {self.shape[1:]}",
                    "record again, or leave it out",
                )
            if self.stored_dtype.kind == "f":
                image = image.astype(np.float32)
                largest = float(np.abs(image).max())
                if not largest <= MAX_LEVEL:
                    what = f"grey level {largest:.3g}" if isfinite(largest) else "NaN or infinity"
                    raise InputError(f"{self.path.name}: frame {index} holds {what}", "use the raw frames")
            return np.asarray(image, self.dtype)

    def times_s(self) -> NDArray[np.float64] | None:
        """Return the time of each frame in seconds, (T,), or None if the file has none."""
        if self._times_s is not None:
            return self._times_s.copy()
        period = self.metadata.get("frame_period_s")
        return None if period is None else np.arange(self.shape[0], dtype=np.float64) * float(period)

    def frame_numbers(self) -> NDArray[np.int64]:
        """Return the camera's number of each frame, (T,); gaps are dropped frames."""
        return np.arange(self.shape[0], dtype=np.int64)

    def _usable_times_s(self, values: Sequence[float | None]) -> NDArray[np.float64] | None:
        """Return the times in a file, (T,), if each frame has one that is not before that of the frame before it."""
        times_s = np.array(values, np.float64)  # None is NaN
        absent = int((~np.isfinite(times_s)).sum())
        if absent == len(times_s):
            return None
        problem = ""
        if len(times_s) != self.shape[0]:
            problem = f"it has {len(times_s)} for {self.shape[0]} frames"
        elif absent:
            problem = f"{absent} of {self.shape[0]} frames have none"
        elif len(back := np.flatnonzero(np.diff(times_s) < 0)):
            problem = f"frame {back[0] + 1} is {-np.diff(times_s)[back[0]]:.3g} s before frame {back[0]}"
        if not problem:
            return times_s
        self.remarks.append(
            f"the frames' times in {self.path.name} are not used, as {problem}: save the frames with a time each, in "
            "their order"
        )
        return None

    def close(self) -> None:  # noqa: B027 - some formats hold nothing open
        """Close the file."""


@contextmanager
def decoding(path: Path, what: str = "it") -> Iterator[None]:
    """Raise every error of a decoder as :class:`InputError`, in one line.

    Decoders read untrusted bytes and may raise anything, so all exceptions are caught here.

    Parameters
    ----------
    path : pathlib.Path
        What is decoded.
    what : str
        Part of it, for the message.
    """
    try:
        yield
    except ElsPlusError:
        raise
    except FileNotFoundError:
        raise InputError(f"there is no file {path}", "check the path") from None
    except PermissionError:
        raise InputError(f"{path} may not be read", "check its permissions") from None
    except Exception as error:
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        raise InputError(
            f"{path.name}: {what} cannot be read ({reason:.100})", "the file is damaged or foreign"
        ) from error


def positive(value: object) -> float | None:
    """Return the value if it is a positive, finite number."""
    try:
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        return None
    return number if isfinite(number) and number > 0 else None
