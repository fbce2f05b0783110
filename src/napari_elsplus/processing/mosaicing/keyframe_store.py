"""Keyframes from which a mosaic is re-rendered at corrected poses: bounded in memory, not in path length."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from math import hypot
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Container, Sequence

    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.motion.pose import Pose

MIN_SPACING: Final = 0.05
"""Initial path between keyframes, bundle diameters; chosen: each place is covered by about twenty."""
MAX_SPACING: Final = 0.4
"""Path between keyframes when memory is short, bundle diameters; derived: with more, discs of 0.9 diameters thinned out
to every second (2 x 0.4 apart) would leave gaps."""
_REPLACEMENT_RADIUS: Final = 0.75
"""Distance within which a newer keyframe replaces an older one, fraction of the spacing; chosen: below 1, so that
successive keyframes do not replace each other."""
_TARGET_FILL: Final = 0.75
"""Fraction of the capacity that thinning leaves at most; chosen: the next thinning is then a while away."""
_FIRST_THINNING: Final = 1000
"""Number of keyframes at which they are thinned for the first time; chosen: less are not worth the time."""
_MIN_QUANTUM: Final = 1 / 16
"""Smallest step of the stored integers, grey levels; chosen: far below the noise of an 8-bit camera."""
_INT16_MAX: Final = 32767
"""Largest int16, to which the brightest pixel is scaled at most (derived)."""


class Keyframe(NamedTuple):
    """Frame with its pose, from which mosaics are re-rendered.

    Parameters
    ----------
    frame : int
        Its number.
    pose : Pose
        As tracked, before any correction.
    packed : numpy.ndarray
        (side, side) int16, in steps of `quantum`.
    quantum : float
        Grey levels per step: a sixteenth, or as many as the brightest pixel needs to fit.
    """

    frame: int
    pose: Pose
    packed: NDArray[np.int16]
    quantum: float = _MIN_QUANTUM

    def image(self, out: NDArray[np.float32]) -> NDArray[np.float32]:
        """Write the frame's grey levels into `out`, (side, side) float32, and return it."""
        return np.multiply(self.packed, np.float32(self.quantum), out=out)


class KeyframeStore:
    """Keyframes along a path, as dense as memory allows.

    One thread adds; another one may thin and read.

    Parameters
    ----------
    diameter_px : float
        Diameter of the bundle, pixels of the tracking grid.
    capacity : int
        Largest number of keyframes.

    Attributes
    ----------
    frames : list of Keyframe
        In the order of their numbers.
    spacing : float
        Path between keyframes in force, bundle diameters.
    full : bool
        True once they are at :data:`MAX_SPACING` and still exceed the capacity: no more are added, and the mosaic can
        no longer be re-rendered from them.

    Examples
    --------
    >>> from napari_elsplus.processing.tracking.motion.rolling_shutter import Velocity
    >>> from napari_elsplus.processing.tracking.motion.pose import Pose, TrackingState
    >>> store, image = KeyframeStore(100.0, capacity=20), np.ones((4, 4), np.float32)
    >>> for frame in range(40):
    ...     _ = store.add(frame, Pose(0, 0.0, 3.0 * frame, Velocity(0.0, 3.0), 1.0, 0.1, TrackingState.TRACKED), image)
    >>> len(store.frames)
    20
    >>> store.thin(lambda keyframe: keyframe.pose)
    True
    >>> len(store.frames), store.frames[-1].frame
    (10, 38)
    """

    def __init__(self, diameter_px: float, capacity: int) -> None:
        self._diameter_px, self._capacity, self._due = diameter_px, capacity, _FIRST_THINNING
        self.spacing = MIN_SPACING
        self.frames: list[Keyframe] = []
        self.full = False
        self._last: Pose | None = None
        self._travelled = 0.0

    @property
    def needs_thinning(self) -> bool:
        """True if the capacity is reached, or their number has doubled since they were last thinned."""
        return len(self.frames) >= min(self._capacity, self._due) and not self.full

    def add(
        self, frame: int, pose: Pose, image: NDArray[np.float32], exposure: float = 1.0, *, always: bool = False
    ) -> bool:
        """Add a frame if the probe has moved by the spacing since the last keyframe; return True if it was added.

        Parameters
        ----------
        frame : int
            Its number.
        pose : Pose
            Pose in state tracked.
        image : numpy.ndarray
            (side, side) float32 grey levels.
        exposure : float
            Factor by which they are multiplied.
        always : bool
            Add it regardless of the distance.
        """
        before, self._last = self._last, pose
        begins = before is None or before.segment != pose.segment
        if before is not None and not begins:
            self._travelled += hypot(pose.row - before.row, pose.col - before.col)
        if self.full or not (begins or always or self._travelled >= self.spacing * self._diameter_px):
            return False
        self._travelled = 0.0
        peak = exposure * max(float(image.max()), -float(image.min()))
        quantum = max(_MIN_QUANTUM, peak / _INT16_MAX)
        steps = np.multiply(image, np.float32(exposure / quantum))
        self.frames.append(Keyframe(frame, pose, np.rint(steps, out=steps).astype(np.int16), quantum))
        return True

    def recent(self, frame: int) -> Keyframe | None:
        """Return the keyframe with a frame number if it is one of the last two, otherwise None."""
        return next((keyframe for keyframe in self.frames[-2:] if keyframe.frame == frame), None)

    def thin(self, place: Callable[[Keyframe], Pose], lock: AbstractContextManager[Any] | None = None) -> bool:
        """Remove keyframes covered by newer ones, at doubled spacing if that is not enough; return True if any went.

        Parameters
        ----------
        place : callable
            Returns the corrected pose of a keyframe.
        lock : context manager, optional
            Held while keyframes are removed, so that none is added meanwhile.
        """
        frames = self.frames[:]
        places = [place(keyframe) for keyframe in frames]
        retained = list(range(len(frames)))
        while True:
            retained = _newest_apart(
                [places[k] for k in retained], retained, _REPLACEMENT_RADIUS * self.spacing * self._diameter_px
            )
            if len(retained) <= _TARGET_FILL * self._capacity:
                break
            if self.spacing >= MAX_SPACING:
                self.full = True
                break
            self.spacing = min(2 * self.spacing, MAX_SPACING)
        self._due = max(_FIRST_THINNING, 2 * len(retained))
        with lock or nullcontext():
            self.frames[: len(frames)] = [frames[k] for k in retained]
        return len(retained) < len(frames)

    def discard(self, segments: Container[int]) -> None:
        """Remove the keyframes of some of the tracker's segments."""
        self.frames[:] = [keyframe for keyframe in self.frames if keyframe.pose.segment not in segments]


def _newest_apart(places: Sequence[Pose], numbers: Sequence[int], apart_px: float) -> list[int]:
    """Return the numbers of frames with no newer one of their segment within a distance, in their order."""
    cells: dict[tuple[int, int, int], list[tuple[float, float]]] = {}
    retained = []
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
            retained.append(number)
    return retained[::-1]
