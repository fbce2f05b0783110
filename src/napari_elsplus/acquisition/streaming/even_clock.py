"""Times of frames on a camera's clock, without its jumps."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from napari_elsplus.errors import DeviceError

if TYPE_CHECKING:
    from napari_elsplus.hardware.protocols import FrameInfo

AHEAD_S: Final = 3.0
"""Seconds that a frame may be later than its number says; chosen: one that sends nothing for so long has failed."""
BACK_S: Final = 0.1
"""Seconds that it may be earlier; chosen: many times what software timestamps vary by."""


class EvenClock:
    """Makes up for jumps of the camera's clock, so that times go on as the frame numbers do.

    Parameters
    ----------
    frame_period_s : float
        Seconds from one frame to the next.

    Examples
    --------
    >>> from napari_elsplus.hardware.protocols import FrameInfo
    >>> clock = EvenClock(0.01)
    >>> [clock.readout_start_s(FrameInfo(number, 0.0, time_s)) for number, time_s in enumerate((0.0, 0.01, 3600.02))]
    [0.0, 0.01, 0.02]
    >>> round(clock.jump_s)
    3600
    """

    def __init__(self, frame_period_s: float) -> None:
        self._period_s = frame_period_s
        self._last: tuple[int, float] | None = None
        self._offset_s = 0.0
        self.jump_s = 0.0
        """By how much the clock had jumped at the newest frame; 0 if it did not."""

    def readout_start_s(self, info: FrameInfo) -> float:
        """Return the start of the readout of the next frame by its number and times in `info`, in seconds.

        Raises
        ------
        DeviceError
            If its number is not above the last one: the camera counts anew.
        """
        start_s = info.readout_start_s - self._offset_s
        self.jump_s = 0.0
        if self._last is not None:
            number, last_s = self._last
            if info.frame_number <= number:
                raise DeviceError(
                    f"the camera counts its frames anew, {info.frame_number} after {number}",
                    "nobody can say how many are missing: start the stream again",
                )
            due_s = last_s + (info.frame_number - number) * self._period_s
            if not -BACK_S < start_s - due_s < AHEAD_S:
                self.jump_s = start_s - due_s
                self._offset_s += self.jump_s
                start_s = due_s
        self._last = info.frame_number, start_s
        return start_s
