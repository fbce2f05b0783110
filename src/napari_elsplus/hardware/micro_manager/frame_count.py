"""Numbers and times of frames by the tags of MMCore, also where it begins both anew in a sequence."""

from __future__ import annotations

from collections import Counter
from math import inf
from typing import TYPE_CHECKING

from napari_elsplus.errors import DeviceError

if TYPE_CHECKING:
    from collections.abc import Mapping

CORE_NUMBER, ELAPSED_MS = "ImageNumber", "ElapsedTime-ms"
"""Tags that MMCore adds to every image: its count and its time since the sequence began, in milliseconds."""


class FrameCount:
    """Counts the frames of one sequence, and those that are missing.

    A number that MMCore has given and that is missing was discarded by it, because nothing read the frames. Where
    the core begins numbers and times anew, the number of missing frames follows from the camera's own count if there is
    a tag of it, else from the time that has passed.

    Parameters
    ----------
    number_tag : str
        Tag by which the camera's frames are counted.
    frame_rate_hz : float
        Frames per second.

    Attributes
    ----------
    dropped : collections.Counter
        Frames lost, by cause.
    in_core : int
        Frames that had reached MMCore when the newest one that was read did.
    """

    def __init__(self, number_tag: str, frame_rate_hz: float) -> None:
        self._tag, self._rate_hz = number_tag, frame_rate_hz
        self.dropped: Counter[str] = Counter()
        self.in_core = 0
        self._number, self._first = -1, 0
        self._core_offset, self._offset_s = 0, 0.0
        self._time_s, self._zero_s = 0.0, inf

    def add(self, tags: Mapping[str, str], received_s: float, waiting: int) -> tuple[int, float]:
        """Return the number and the time of the next frame, in seconds since the sequence began.

        Parameters
        ----------
        tags : mapping of str to str
            Its tags.
        received_s : float
            Time at which it was read.
        waiting : int
            Frames in MMCore that came after it.

        Raises
        ------
        DeviceError
            If it has no tag of that name.
        """
        if self._tag not in tags:
            raise DeviceError(f"the frames carry no tag {self._tag}", f"choose among {', '.join(sorted(tags))}")
        in_core = int(tags[CORE_NUMBER]) + self._core_offset
        time_s = float(tags[ELAPSED_MS]) * 1e-3 + self._offset_s
        own = None if self._tag == CORE_NUMBER else int(tags[self._tag])
        if self._number < 0:
            self._first = 0 if own is None else own - in_core
        elif in_core < self.in_core:
            by_time = round((received_s - self._zero_s - self._time_s) * self._rate_hz) - waiting
            passed = max(1, by_time if own is None else own - self._first - self._number)
            self._core_offset += self.in_core - 1 + passed - in_core
            self._offset_s += self._time_s + passed / self._rate_hz - time_s
            return self.add(tags, received_s, waiting)
        number = in_core if own is None else own - self._first
        discarded, missing = in_core - self.in_core, number - self._number - 1
        for cause, count in (("slow consumer", discarded), ("gap", missing - discarded)):
            if count > 0:
                self.dropped[cause] += count
        self._number, self.in_core, self._time_s = number, in_core + 1, time_s
        self._zero_s = min(self._zero_s, received_s - time_s)
        return number, time_s
