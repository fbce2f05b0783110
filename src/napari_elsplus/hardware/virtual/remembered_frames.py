"""Frames of a probe on a closed path, or the light of each, remembered between starts in the user's cache folder.

They are mapped into memory, which is quicker than to render them. The folder may be deleted at any time.
"""

from __future__ import annotations

import hashlib
import mmap
import os
import pickle
import shutil
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from napari_elsplus.io.user_folders import cache_folder, software_fingerprint

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from numpy.typing import NDArray

    Frames = NDArray[np.uint8] | NDArray[np.float32]
    Rows = NDArray[np.float64]

MAX_FILES: Final = 3
"""Files kept, 0.3 GB each; chosen: two presets, and another calibration of one."""
MIN_FREE_SHARE: Final = 10
"""Free space of the disk over a file's size from which it is written; chosen: a cache never fills a disk."""


def frames_key(*made_of: Any) -> str:
    """Return the key of frames that instrument, scene, path and seed determine, with this version of the software."""
    return hashlib.sha256(software_fingerprint().encode() + pickle.dumps(made_of)).hexdigest()[:16]


def recall_frames(key: str, like: Frames, rows: int, rows_alike: Callable[[Rows], bool]) -> Frames | None:
    """Map remembered frames into memory, copied when written to; None if there are none, or they cannot be read.

    Parameters
    ----------
    key : str
        From :func:`frames_key`.
    like : numpy.ndarray
        Frames of shape and dtype that are expected: (frames, rows, cols) uint8, or light of any shape, float32.
    rows : int
        Rows of a frame.
    rows_alike : callable
        Returns True if frames for such line positions (rows,) are the right ones.
    """
    for path in _folder().glob(f"frames-{key}-*.npy"):
        with suppress(Exception), path.open("rb") as file:  # of a spoilt file numpy raises what its parts do
            line_rows = np.load(file)
            if line_rows.shape == (rows,) and rows_alike(line_rows):
                frames = np.memmap(file, like.dtype, "c", file.tell(), like.shape)
                frames.reshape(-1)[:: mmap.PAGESIZE // like.itemsize].max()  # no page is read while frames stream
                path.touch()
                return np.asarray(frames)
    return None


def remember_frames(key: str, line_rows: Rows, frames: Frames) -> None:
    """Write the `frames` of a `key` for some line positions, and remove the oldest files beyond `MAX_FILES`.

    What a killed program left unfinished is among them.
    A folder that refuses, and a disk that is nearly full, cost only time at the next start.
    """
    folder = _folder()
    with suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
        if shutil.disk_usage(folder).free < MIN_FREE_SHARE * frames.nbytes:
            return
        path = folder / f"frames-{key}-{hashlib.sha256(line_rows.tobytes()).hexdigest()[:8]}.npy"
        unfinished = path.with_suffix(f".{os.getpid()}")
        try:
            with unfinished.open("wb") as file:
                np.save(file, line_rows)
                frames.tofile(file)
            unfinished.replace(path)
        finally:
            unfinished.unlink(missing_ok=True)
        for old in sorted(folder.glob("frames-*"), key=lambda file: file.stat().st_mtime)[:-MAX_FILES]:
            old.unlink(missing_ok=True)


def _folder() -> Path:
    return cache_folder() / "frames"
