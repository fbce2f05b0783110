"""Videos as other programs write them: frames without a word on the instrument."""

from __future__ import annotations

import subprocess
from pathlib import Path

import imageio_ffmpeg
import numpy as np


def write_avi(path: Path, frames: np.ndarray, *options: str, pixels: str = "gray", rate_hz: str = "50") -> None:
    """Frames (T, rows, cols) uint8 as an AVI, uncompressed unless options say otherwise."""
    rows, cols = frames.shape[1:3]
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-v", "quiet", "-f", "rawvideo", "-pix_fmt", pixels, "-r", rate_hz]
    command += ["-s", f"{cols}x{rows}", "-i", "-", *(options or ("-c:v", "rawvideo")), str(path)]
    subprocess.run(command, input=frames.tobytes(), check=True)
