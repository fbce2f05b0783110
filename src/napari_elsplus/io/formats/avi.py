"""AVI recordings of a grey camera, decoded by the ffmpeg of imageio-ffmpeg, the extra `video`."""

from __future__ import annotations

import subprocess
from fractions import Fraction
from threading import Lock
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from napari_elsplus.errors import InputError
from napari_elsplus.io.formats.extras import extra_needed
from napari_elsplus.io.formats.registry import FileFormat
from napari_elsplus.io.formats.source import FrameSource, decoding

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

MAX_SKIPPED_FRAMES: Final = 30
"""A jump forwards of at most so many frames decodes those between; a longer one starts the decoder again. Chosen: about
what the start of ffmpeg costs; any value from 10 to 100 does."""
MAX_TINT: Final = 4
"""Grey levels by which red or blue may differ from green; measured: 2 where OpenCV encoded grey as JPEG, by how
it rounds. Green then is the grey that was encoded."""


class Video(FrameSource):
    """Frames of a video, decoded in sequence; a jump backwards or far forwards starts the decoder again.

    Its clock ticks once a frame period: frames that were dropped when it was written are ticks without a frame.
    """

    def __init__(self, path: Path) -> None:
        rows, cols = _first_frame_shape(path)
        self._ticks, tick_s = _ticks_of_frames(path)
        count = len(self._ticks)
        if count < 1:
            raise InputError(f"{path.name} holds no frames", "copy or record it again")
        self._period_s = _frame_period_s(path) or tick_s
        self._decoder: subprocess.Popen[bytes] | None = None
        self._next = 0
        self._lock = Lock()
        super().__init__(
            path, (count, rows, cols), np.dtype(np.uint8), {"frame_period_s": self._period_s, "playback": True}
        )

    def frame(self, index: int) -> NDArray[Any]:
        """Return frame `index`, (rows, cols) of uint8."""
        import cv2  # here: the process that submits a batch does without it

        with self._lock:
            if self._decoder is None or not 0 <= index - self._next <= MAX_SKIPPED_FRAMES:
                self._start_at(index)
            while self._next < index:
                self._read(index)
            pixels = self._read(index)
        image = np.frombuffer(pixels, np.uint8).reshape(*self.shape[1:], 3)
        grey = np.ascontiguousarray(image[..., 1])
        if max(cv2.norm(np.ascontiguousarray(image[..., k]), grey, cv2.NORM_INF) for k in (0, 2)) > MAX_TINT:
            raise InputError(f"{self.path.name}: frame {index} is in colour", "save the video as grey levels")
        return grey

    def frame_numbers(self) -> NDArray[np.int64]:
        """Return the tick of each frame, (T,); gaps are frames that were dropped."""
        return self._ticks

    def times_s(self) -> NDArray[np.float64]:
        """Return the time of each frame in seconds, (T,), as the video is played back."""
        return self._ticks.astype(np.float64) * self._period_s

    def close(self) -> None:
        """Stop the decoder."""
        with self._lock:
            self._stop()

    def _start_at(self, index: int) -> None:
        self._stop()
        start_s = (self._ticks[index] - 0.25) * self._period_s  # ffmpeg starts at the first frame that is not earlier
        seek = ["-ss", f"{start_s:.6f}"] if index else []
        even = ["-vf", "setpts=N/FRAME_RATE/TB"]  # else ffmpeg repeats frames in the place of dropped ones
        self._decoder = subprocess.Popen(
            _command(*seek, "-i", str(self.path), *even, "-f", "rawvideo", "-pix_fmt", "rgb24", "-"),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        )
        self._next = index

    def _read(self, index: int) -> bytes:
        assert self._decoder is not None
        assert self._decoder.stdout is not None
        size = 3 * self.shape[1] * self.shape[2]
        pixels = self._decoder.stdout.read(size)
        if len(pixels) < size:
            self._stop()
            raise InputError(f"{self.path.name}: frame {index} is missing", "the video is damaged: copy it again")
        self._next += 1
        return pixels

    def _stop(self) -> None:
        decoder, self._decoder = self._decoder, None
        if decoder is not None:
            decoder.kill()
            decoder.communicate()


def open_video(path: Path) -> FrameSource:
    """Open the AVI file at `path`.

    Raises
    ------
    InputError
        If it cannot be decoded, or its first frame is in colour.
    """
    with decoding(path):
        video = Video(path)
        try:
            video.frame(0)
        except BaseException:
            video.close()
            raise
        return video


def _command(*options: str) -> list[str]:
    with extra_needed("video", "AVI files"):
        import imageio_ffmpeg

    return [imageio_ffmpeg.get_ffmpeg_exe(), "-nostdin", "-v", "error", *options]


def _first_frame_shape(path: Path) -> tuple[int, int]:
    """Rows and columns, from the header of the first frame as a portable pixmap."""
    command = _command("-i", str(path), "-frames:v", "1", "-f", "image2pipe", "-c:v", "ppm", "-")
    run = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, check=False)
    header = run.stdout[:40].split()
    if run.returncode or header[:1] != [b"P6"]:
        messages = run.stderr.decode(errors="replace").strip().splitlines()
        reason = messages[-1] if messages else "no frame"
        raise InputError(f"{path.name} cannot be decoded ({reason:.100})", "the file is damaged or no video")
    return int(header[2]), int(header[1])


def _ticks_of_frames(path: Path) -> tuple[NDArray[np.int64], float]:
    """Return the tick of the file's clock at which each frame is displayed, (T,), from 0, and the tick in seconds.

    Frames are counted from 0 where the file does not give each a tick of its own.
    """
    command = _command("-i", str(path), "-map", "0:v:0", "-c", "copy", "-f", "framecrc", "-")
    run = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, check=False)
    lines = run.stdout.decode(errors="replace").splitlines()
    ticks_s = (float(Fraction(line.split(":")[1].strip())) for line in lines if line.startswith("#tb 0:"))
    packets = (line.split(",") for line in lines if not line.startswith("#"))
    ticks = np.sort(np.array([int(packet[2]) for packet in packets if int(packet[4]) > 0], np.int64))
    if len(ticks) and (ticks[0] < 0 or (np.diff(ticks) < 1).any()):
        ticks = np.arange(len(ticks), dtype=np.int64)
    return ticks - ticks[:1], next(ticks_s, 0.0)


def _frame_period_s(path: Path) -> float:
    """Time between frames, seconds, from the file's header, as ffmpeg rounds the duration it prints; 0 if unknown."""
    import cv2  # here: the process that submits a batch does without it

    video = cv2.VideoCapture(str(path))
    rate_hz = video.get(cv2.CAP_PROP_FPS)
    video.release()
    return 1 / rate_hz if 0 < rate_hz < np.inf else 0.0


AVI: Final = FileFormat("AVI", (".avi",), open_video)
