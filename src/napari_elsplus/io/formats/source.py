"""What every format of recording offers: frames at random, times, and what is known of them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from contextlib import contextmanager
from math import isfinite
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from napari_elsplus.errors import ElsPlusError, InputError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from numpy.typing import NDArray

LARGEST_FRAME: Final = 1 << 30
"""Bytes; a header that asks for more is taken to be broken."""


class FrameSource(ABC):
    """Frames of one format, read one at a time and from any thread.

    Parameters
    ----------
    path : pathlib.Path
        File or folder.
    shape : tuple of int
        (T, rows, cols).
    dtype : numpy.dtype
        uint8, uint16 or float; floats are handed out as float32.
    metadata : dict, optional
        What the file says: ``um_per_px``, ``frame_period_s``, ``times_s``, ``settings``, ``software``, ``calibration``.

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
        if dtype.kind != "f" and dtype not in (np.uint8, np.uint16):
            raise InputError(f"{path.name} holds {dtype} pixels", "save it with 8 or 16 bits, unsigned, or as float")
        frame_bytes = shape[1] * shape[2] * dtype.itemsize
        if frame_bytes > LARGEST_FRAME:
            raise InputError(f"{path.name} declares frames of {shape[1]} x {shape[2]} pixels", "the file is damaged")
        self.path = path
        self.shape = shape
        self.stored_dtype = dtype
        self.dtype = np.dtype(np.float32) if dtype.kind == "f" else dtype.newbyteorder("=")
        self.metadata: dict[str, Any] = metadata or {}

    @abstractmethod
    def frame(self, index: int) -> NDArray[Any]:
        """Read one frame, (rows, cols), as the file holds it."""

    def block(self, indices: range) -> NDArray[Any]:
        """Read several frames, (len(indices), rows, cols)."""
        out = np.empty((len(indices), *self.shape[1:]), self.dtype)
        for image, index in zip(out, indices, strict=True):
            image[:] = self.checked(index)
        return out

    def checked(self, index: int) -> NDArray[Any]:
        """Read one frame and make sure that it is what the recording promised."""
        with decoding(self.path, f"frame {index}"):
            image = self.frame(index)
            if image.shape != self.shape[1:]:
                raise InputError(
                    f"{self.path.name}: frame {index} has shape {image.shape}, the others {self.shape[1:]}",
                    "record again, or leave it out",
                )
            if self.stored_dtype.kind == "f":
                image = image.astype(np.float32)
                if not np.isfinite(image).all():
                    raise InputError(f"{self.path.name}: frame {index} holds NaN or infinity", "use the raw frames")
            return np.asarray(image, self.dtype)

    def times_s(self) -> NDArray[np.float64] | None:
        """Time of each frame, if the file knows it."""
        times = self.metadata.get("times_s")
        if times is not None and len(times) == self.shape[0]:
            return np.asarray(times, np.float64)
        period = self.metadata.get("frame_period_s")
        return None if period is None else np.arange(self.shape[0], dtype=np.float64) * float(period)

    def frame_numbers(self) -> NDArray[np.int64]:
        """Camera's number of each frame; gaps are dropped frames."""
        return np.arange(self.shape[0], dtype=np.int64)

    def close(self) -> None:  # noqa: B027 - some formats hold nothing open
        """Let go of the file."""


@contextmanager
def decoding(path: Path, what: str = "it") -> Iterator[None]:
    """Turn whatever a decoder makes of a broken file into one line.

    Decoders meet untrusted bytes and may raise anything at all, so this seam catches everything that is an error.
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
