"""Frames kept so that a mosaic can be laid anew where they turn out to belong: bounded in memory, not in path."""

from __future__ import annotations

from contextlib import nullcontext
from math import hypot
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Container, Sequence
    from contextlib import AbstractContextManager

    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.motion.pose import Pose

MIN_SPACING: Final = 0.05
"""Path between frames that are kept, in bundle diameters, to begin with."""
MAX_SPACING: Final = 0.4
"""The same when memory is short; with larger ones the discs would no longer cover what they passed over."""
_APART: Final = 0.75
"""Part of the spacing within which a newer frame takes the place of an older one."""
_FILLED: Final = 0.75
_FEW: Final = 1000
"""So many frames are kept before any are looked at again."""
_STEPS: Final = 16
"""Per grey level: between -2048 and 2047, where a flat field of 0.2 takes white to 1275."""


class Keyframe(NamedTuple):
    """A frame, and where the tracker has it.

    Parameters
    ----------
    frame : int
        Its number.
    pose : Pose
        Where the tracker has it.
    packed : numpy.ndarray
        (side, side) int16: sixteenths of a grey level of an 8-bit camera, which is far below its noise.
    """

    frame: int
    pose: Pose
    packed: NDArray[np.int16]

    def image(self, out: NDArray[np.float32]) -> NDArray[np.float32]:
        """Fill an array with the frame's grey levels, and return it."""
        return np.multiply(self.packed, np.float32(1 / _STEPS), out=out)


class KeyframeStore:
    """Frames along a path, the nearer to one another the more memory there is.

    One thread keeps; another one may thin them out, and read.

    Parameters
    ----------
    diameter_px : float
        Of the bundle, pixels of the tracking grid.
    capacity : int
        Frames that memory has room for.

    Attributes
    ----------
    frames : list of Keyframe
        In their order.
    full : bool
        Whether they are as far apart as they may be, and there is still no room for more: none are kept any more, and
        the mosaic can no longer be laid anew from them.

    Examples
    --------
    >>> from napari_elsplus.processing.tracking.motion.rolling_shutter import Velocity
    >>> from napari_elsplus.processing.tracking.motion.pose import Pose, State
    >>> kept, image = KeyframeStore(100.0, capacity=20), np.ones((4, 4), np.float32)
    >>> for frame in range(40):
    ...     _ = kept.add(frame, Pose(0, 0.0, 3.0 * frame, Velocity(0.0, 3.0), 1.0, 0.1, State.TRACKED), image)
    >>> len(kept.frames)
    20
    >>> kept.thin(lambda one: one.pose)
    True
    >>> len(kept.frames), kept.frames[-1].frame
    (10, 38)
    """

    def __init__(self, diameter_px: float, capacity: int) -> None:
        self._diameter_px, self._capacity, self._due = diameter_px, capacity, _FEW
        self.spacing = MIN_SPACING
        self.frames: list[Keyframe] = []
        self.full = False
        self._before: Pose | None = None
        self._gone = 0.0

    @property
    def needs_thinning(self) -> bool:
        """Whether it is time to thin them out: there is no more room, or they have doubled since the last time."""
        return len(self.frames) >= min(self._capacity, self._due) and not self.full

    def add(
        self, frame: int, pose: Pose, image: NDArray[np.float32], exposure: float = 1.0, *, always: bool = False
    ) -> bool:
        """Keep a frame if the probe has gone far enough since the last that was; whether it was kept.

        Parameters
        ----------
        frame : int
            Its number.
        pose : Pose
            Where the tracker has it; tracked.
        image : numpy.ndarray
            (side, side) float32 grey levels.
        exposure : float
            What they are multiplied by.
        always : bool
            Keep it however near it is.
        """
        before, self._before = self._before, pose
        begins = before is None or before.segment != pose.segment
        if before is not None and not begins:
            self._gone += hypot(pose.row - before.row, pose.col - before.col)
        if self.full or not (begins or always or self._gone >= self.spacing * self._diameter_px):
            return False
        self._gone = 0.0
        steps = np.multiply(image, np.float32(_STEPS * exposure))
        self.frames.append(Keyframe(frame, pose, np.rint(steps, out=steps).astype(np.int16)))
        return True

    def recent(self, frame: int) -> Keyframe | None:
        """Return a frame, if it is one of the last two that were kept."""
        return next((one for one in self.frames[-2:] if one.frame == frame), None)

    def thin(self, place: Callable[[Keyframe], Pose], lock: AbstractContextManager[Any] | None = None) -> bool:
        """Let go of frames that lie under newer ones, and where that is not enough, of every second; whether any went.

        Parameters
        ----------
        place : callable
            Returns where a frame belongs.
        lock : context manager, optional
            Held while frames are taken out, so that nobody keeps another one meanwhile.
        """
        frames = self.frames[:]
        places = [place(one) for one in frames]
        left = list(range(len(frames)))
        while True:
            left = _newest_apart([places[k] for k in left], left, _APART * self.spacing * self._diameter_px)
            if len(left) <= _FILLED * self._capacity:
                break
            if self.spacing >= MAX_SPACING:
                self.full = True
                break
            self.spacing = min(2 * self.spacing, MAX_SPACING)
        self._due = max(_FEW, 2 * len(left))
        with lock or nullcontext():
            self.frames[: len(frames)] = [frames[k] for k in left]
        return len(left) < len(frames)

    def discard(self, segments: Container[int]) -> None:
        """Let go of the frames of some of the tracker's segments."""
        self.frames[:] = [one for one in self.frames if one.pose.segment not in segments]


def _newest_apart(places: Sequence[Pose], numbers: Sequence[int], apart_px: float) -> list[int]:
    """Of frames that lie nearer to one another than that in one segment, only the newest."""
    cells: dict[tuple[int, int, int], list[tuple[float, float]]] = {}
    left = []
    for place, number in zip(reversed(places), reversed(numbers), strict=True):
        row, col = int(place.row // apart_px), int(place.col // apart_px)
        around = (
            there
            for down in (-1, 0, 1)
            for across in (-1, 0, 1)
            for there in cells.get((place.segment, row + down, col + across), ())
        )
        if all(hypot(place.row - r, place.col - c) >= apart_px for r, c in around):
            cells.setdefault((place.segment, row, col), []).append((place.row, place.col))
            left.append(number)
    return left[::-1]
