"""What the motion so far suggests of the next frame, and how much that has been worth.

A hand keeps its velocity, and for a moment some of its acceleration; how far the next velocity may be from that is
learnt from how far the last ones were.
"""

from __future__ import annotations

from math import hypot, isfinite
from typing import TYPE_CHECKING, Final

from napari_elsplus.processing.tracking.motion.rolling_shutter import Displacement, Velocity

if TYPE_CHECKING:
    from napari_elsplus.processing.tracking.motion.rolling_shutter import RollingShutter

AT_REST: Final = Velocity(0.0, 0.0)
UNEVEN: Final = 0.03
"""Error of a displacement, root mean square, per change of the acceleration (pixels per frame squared)."""
SMOOTH_MOTION_PX: Final = 5.0
"""Spread of the velocity up to which the motion is so smooth that it tells where to look."""
_LEAST_SPREAD: Final = 1.0
_MEMORY: Final = 0.3
_FIRST_SURPRISE: Final = 4.0
_SPREAD_OF_SURPRISE: Final = 1.5
_UNEVENLY: Final = 0.15
"""Part of the surprise by which the velocity does not change evenly from frame to frame."""
_FIRST_TURN: Final = 0.004
_LEAST_TURN: Final = 0.0005
"""Radians per frame by which a turn may well differ from what is expected: before any was seen, and at least."""
_KEPT: Final = 0.5
"""Part of the last change of velocity that is expected to go on."""


class Motion:
    """Velocity and acceleration of the probe, as far as accepted links tell.

    Parameters
    ----------
    shutter : RollingShutter
        Timing of the rows.

    Attributes
    ----------
    known : bool
        Whether any link was accepted yet.
    velocity, change : Velocity
        During the last frame that was linked, and what it gained over the frame before; pixels per frame period.
    surprise : float
        How far velocities were from what was expected of them, of late.

    Examples
    --------
    >>> from napari_elsplus.processing.tracking.motion.rolling_shutter import RollingShutter
    >>> motion = Motion(RollingShutter(300.0))
    >>> motion.follow(Velocity(20.0, 0.0), successive=True)
    >>> motion.follow(Velocity(22.0, 0.0), successive=True)
    >>> motion.ahead(1)
    Displacement(row=22.5, col=0.0)
    """

    def __init__(self, shutter: RollingShutter) -> None:
        self._shutter = shutter
        self.forget()

    def forget(self) -> None:
        """Start anew."""
        self.known = False
        self.velocity = self.change = AT_REST
        self.surprise = _FIRST_SURPRISE

    def follow(self, velocity: Velocity, *, successive: bool) -> None:
        """Take note of a linked frame's velocity; `successive` if the frame just before it was linked as well."""
        gained = AT_REST
        if self.known and successive:
            expected = self.next_velocity
            miss = hypot(velocity.row - expected.row, velocity.col - expected.col)
            self.surprise += _MEMORY * (miss - self.surprise)
            gained = Velocity(velocity.row - self.velocity.row, velocity.col - self.velocity.col)
        self.velocity, self.change, self.known = velocity, gained, True

    def unevenness(self, before: Velocity, velocity: Velocity, *, successive: bool) -> float:
        """Error of a displacement, pixels, because the probe did not move evenly within the frames.

        The rolling shutter's warp is exact for even motion within each frame, and stays so under a steady acceleration.
        What remains grows with the change of the acceleration from frame to frame; where no acceleration is known yet,
        with what the velocity gained from the frame `before`.

        Parameters
        ----------
        before, velocity : Velocity
            Of the earlier and of the later frame, pixels per frame period.
        successive : bool
            True if no frame lies between them.
        """
        if not (successive and isfinite(self._shutter.line_periods_per_frame)):
            return 0.0
        row, col = velocity.row - before.row, velocity.col - before.col
        if self.known:
            row = velocity.row - self.velocity.row - self.change.row
            col = velocity.col - self.velocity.col - self.change.col
        return UNEVEN * hypot(row, col)

    @property
    def next_velocity(self) -> Velocity:
        """Velocity expected in the frames to come."""
        return Velocity(self.velocity.row + _KEPT * self.change.row, self.velocity.col + _KEPT * self.change.col)

    @property
    def spread(self) -> float:
        """Standard deviation of the next velocity about what is expected."""
        return _LEAST_SPREAD + _SPREAD_OF_SURPRISE * self.surprise

    def ahead(self, frames: int) -> Displacement:
        """Displacement expected from the last linked frame to one so many frames later."""
        later = self.next_velocity
        step = self._shutter.step(self.velocity, later)
        return Displacement(step.row + (frames - 1) * later.row, step.col + (frames - 1) * later.col)


class Turning:
    """How fast the probe turns, as far as accepted links tell, and how much that has been worth.

    Attributes
    ----------
    rate : float
        Radians per frame.

    Examples
    --------
    >>> turning = Turning()
    >>> for _ in range(20):
    ...     turning.follow(0.002, 1)
    >>> round(turning.rate, 4), turning.spread(1) < 0.001
    (0.002, True)
    """

    def __init__(self) -> None:
        self.rate = 0.0
        self._surprise = _FIRST_TURN

    def follow(self, turned: float, frames: int) -> None:
        """Take note of what the probe has turned within so many frames."""
        miss = turned / frames - self.rate
        self._surprise += _MEMORY * (abs(miss) - self._surprise)
        self.rate += _MEMORY * miss

    def spread(self, frames: int) -> float:
        """Return the standard deviation of the turn within so many frames about what is expected."""
        return frames * (_LEAST_TURN + _SPREAD_OF_SURPRISE * self._surprise)


def surprise_of(spread_px: float) -> float:
    """Return the surprise that makes the velocity spread so much."""
    return max(spread_px - _LEAST_SPREAD, 0.0) / _SPREAD_OF_SURPRISE


def needed_times(spread_px: float) -> float:
    """How many times the least evidence a link needs: the more, the less the motion tells where to look.

    Parameters
    ----------
    spread_px : float
        How far velocities were, of late, from what was expected of them.
    """
    return max(1.0, spread_px / SMOOTH_MOTION_PX)


def unevenly(surprise_px: float) -> float:
    """Return how far mean velocities may be from what the velocities of the frames around make them.

    Parameters
    ----------
    surprise_px : float
        How far velocities were from their prediction lately, pixels per frame period.
    """
    return _UNEVENLY * surprise_px
