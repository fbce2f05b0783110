"""Which of ELSA's two ramps a frame was taken with, though frames and strobes may be lost.

The card counts the ramps that it began, the camera its frames. A frame that is read late sees more ramps than its own,
never fewer, so the least lead of the ramps over the frames, seen lately, is the true one; a missed strobe lowers it at
once, for good.
"""

from __future__ import annotations

from collections import deque
from typing import Final

from napari_elsplus.errors import InputError

REMEMBERS: Final = 32
"""Frames over which the least lead is taken; after a false edge the parity is right again after so many."""


class RampParity:
    """Ties frame numbers to ramps.

    Parameters
    ----------
    ramps : int
        Ramps that take turns.

    Examples
    --------
    >>> parity = RampParity()
    >>> parity.ramp_of(4, ramps_begun=5), parity.ramp_of(5, ramps_begun=6), parity.ramp_of(6, ramps_begun=8)
    (0, 1, 0)
    >>> parity.ramp_of(7, ramps_begun=7)  # a strobe was missed
    0
    """

    def __init__(self, ramps: int = 2) -> None:
        self._ramps = ramps
        self._leads: deque[int] = deque(maxlen=REMEMBERS)

    def ramp_of(self, frame_number: int, ramps_begun: int) -> int:
        """Return the ramp of a frame: 0 confocal, 1 residual.

        Parameters
        ----------
        frame_number : int
            Of the frame, as the camera counts.
        ramps_begun : int
            The scanner's count, asked after the frame was read.

        Raises
        ------
        InputError
            If no ramp was begun yet.
        """
        if ramps_begun < 1:
            raise InputError(f"frame {frame_number} came before any ramp began", "start the scan before the camera")
        self._leads.append(ramps_begun - frame_number)
        return (frame_number + min(self._leads) - 1) % self._ramps
