"""A camera driver of one's own: frames of a recording, played in a loop at the rate that was configured.

A module that a rig file imports: running it as a script does nothing. The rig file is ``playback.toml`` in this folder;
docs/extending-camera.md goes through both.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from napari_elsplus.errors import DeviceError, InputError
from napari_elsplus.hardware.protocols import FrameInfo, Region
from napari_elsplus.io import open_recording


class PlaybackCamera:
    """A camera whose frames come from a file; implements `napari_elsplus.hardware.protocols.Camera`.

    Parameters
    ----------
    recording : str
        Path of the recording; ``options.recording`` in the rig file.
    line_rate_hz : float
        Rows read per second.
    """

    def __init__(self, recording: str, line_rate_hz: float = 130_750.6) -> None:
        self._frames = open_recording(recording)
        self.frame_shape: tuple[int, int] = (0, 0)
        self.line_period_s = 1 / line_rate_hz
        self.line_periods_per_frame = 0.0
        self.dropped: Mapping[str, int] = {}
        self._frame_number: int | None = None  # None: it does not stream

    def configure(self, region: Region, *, slit_rows: int, frame_rate_hz: float, gain_db: float = 0.0) -> None:
        """Accept the region of the recording, at any frame rate; slit and gain are those of the recording."""
        del slit_rows, gain_db
        if region.shape != self._frames.shape[1:]:
            raise InputError(f"a region of {region.shape}", f"the recording has frames of {self._frames.shape[1:]}")
        self.frame_shape = region.shape
        self.line_periods_per_frame = 1 / (frame_rate_hz * self.line_period_s)

    def start(self) -> None:
        """Play from the beginning."""
        self._frame_number, self._start_s = 0, time.perf_counter()

    def read_into(self, buffer: NDArray[np.uint8], timeout_s: float) -> FrameInfo:
        """Copy the next frame into the buffer once it is due."""
        if self._frame_number is None:
            raise DeviceError("the camera does not stream", "start it first")
        number, period_s = self._frame_number, self.line_periods_per_frame * self.line_period_s
        due_s = self._start_s + (number + 1) * period_s
        if due_s > time.perf_counter() + timeout_s:
            raise TimeoutError(f"no frame within {timeout_s:g} s")
        time.sleep(max(0.0, due_s - time.perf_counter()))
        buffer[...] = self._frames[number % len(self._frames)]
        self._frame_number += 1
        return FrameInfo(number, due_s, number * period_s)

    def stop(self) -> None:
        """End the stream."""
        self._frame_number = None

    def close(self) -> None:
        """Stop, and close the recording."""
        self.stop()
        self._frames.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *reason: object) -> Any:
        self.close()
