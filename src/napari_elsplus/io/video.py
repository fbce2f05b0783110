"""AVI recordings of a grey camera, decoded by ffmpeg."""

from __future__ import annotations

from threading import Lock
from typing import TYPE_CHECKING, Any

import numpy as np

from napari_elsplus.errors import InputError
from napari_elsplus.io.sources import FrameSource, decoding, positive

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray


class Video(FrameSource):
    """Frames of a video; going forwards is fast, a jump starts the decoder anew."""

    def __init__(self, path: Path) -> None:
        import imageio.v2

        if path.stat().st_size == 0:
            raise InputError(f"{path.name} is empty", "copy or record it again")
        reader: Any = imageio.v2.get_reader(path, format="FFMPEG")
        self._reader = reader
        self._lock = Lock()
        about = self._reader.get_meta_data()
        cols, rows = about["size"]
        period = positive(about.get("fps"))
        known = {"frame_period_s": 1 / period} if period else {}
        super().__init__(path, (reader.count_frames(), rows, cols), np.dtype(np.uint8), known)

    def frame(self, index: int) -> NDArray[Any]:
        """Read one frame, (rows, cols), as the file holds it."""
        with self._lock:
            image = np.asarray(self._reader.get_data(index))
        if image.ndim == 2:
            return image
        grey = image[..., 1]
        if not ((image[..., 0] == grey).all() and (image[..., 2] == grey).all()):
            raise InputError(f"{self.path.name}: frame {index} is in colour", "save the video as grey levels")
        return np.ascontiguousarray(grey)

    def close(self) -> None:
        """Let go of the file."""
        self._reader.close()


def open_video(path: Path) -> FrameSource:
    """Open an AVI file; its first frame tells whether it is grey."""
    with decoding(path):
        video = Video(path)
        try:
            video.frame(0)
        except BaseException:
            video.close()
            raise
        return video
