"""Frame after frame: where the probe is, how well that is known, and when it is not.

Each frame is linked to a key frame that is renewed before the overlap shrinks: at fast motion that is the frame
before, at slow motion one key frame serves many frames, so that errors do not add up. The link starts from the motion
so far; it is kept only if the frames themselves single out its shift, and otherwise sought among all shifts. Frames
that no link reaches are predicted for a while, then lost; a new segment starts where frames can be linked again.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from math import hypot, isfinite, nan
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from napari_elsplus.processing.motion import Displacement, Velocity
from napari_elsplus.processing.prediction import AT_REST, Motion
from napari_elsplus.processing.registration import LEAST_EVIDENCE, Link, Registrar, View

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.processing.grid import Grid

KEY_FRAME_REACH: Final = 0.1
"""Displacement from the key frame, in bundle diameters, at which it is renewed."""
PATIENCE_FRAMES: Final = 5
"""Frames without a link that are predicted before the track is lost."""
FARTHEST: Final = 0.6
"""Predicted displacement, in bundle diameters, beyond which no link is tried."""


class State(StrEnum):
    """How much is known of a frame's position."""

    TRACKED = "tracked"
    """Linked to other frames by what they show."""
    PREDICTED = "predicted"
    """Not linked; the position is what the motion before suggests."""
    LOST = "lost"
    """Unknown."""


class Pose(NamedTuple):
    """Where the probe was while one frame was read; pixels of the tracking grid.

    Parameters
    ----------
    segment : int
        Positions are comparable within a segment.
    row, col : float
        Position when the bundle's middle row is read, relative to the segment's first frame; nan if lost.
    velocity : Velocity
        Pixels per frame period.
    score : float
        Correlation of the overlap with the frame that this one was linked to.
    sigma : float
        Larger axis of the position's uncertainty relative to that frame, one standard deviation.
    state : State
        Tracked, predicted or lost.
    """

    segment: int
    row: float
    col: float
    velocity: Velocity
    score: float
    sigma: float
    state: State


SURE_CORRELATION: Final = 0.9
"""Correlation below which a predicted link is compared with all other shifts."""
SMOOTH_MOTION_PX: Final = 5.0
"""Spread of the velocity up to which the motion is so smooth that it tells where to look."""
FALL_OF_CORRELATION: Final = 0.08
"""How far a link's correlation may lie below what was usual so far."""
_MEMORY: Final = 0.2
_VELOCITY_SIGMA: Final = 0.3
"""What the velocity of a linked frame is trusted to."""
_REACH_PX: Final = 8.0
_FIRST_REACH: Final = 0.3


@dataclass(slots=True)
class _Placed:
    """A frame that others can be linked to."""

    view: View
    index: int = -1
    row: float = 0.0
    col: float = 0.0
    velocity: Velocity = AT_REST


class Tracker:
    """Tracks the probe through a sequence of tracking images.

    Parameters
    ----------
    grid : Grid
        The grid of the images, with the timing of its rows.

    Attributes
    ----------
    links : list of tuple
        (earlier frame, later frame, displacement, link) of every accepted link.
    """

    def __init__(self, grid: Grid) -> None:
        self.grid = grid
        self.registrar = Registrar(grid)
        self.links: list[tuple[int, int, Displacement, Link]] = []
        self._slots = [self.registrar.view() for _ in range(4)]
        self._motion = Motion(grid.shutter)
        self._key: _Placed | None = None
        self._last: _Placed | None = None
        self._previous: _Placed | None = None
        self._usual = nan
        self._segment = 0
        self._frames = 0

    def slot(self) -> NDArray[np.float32]:
        """Return the array into which the next image is to be written before :meth:`add` is called."""
        return self._free().image

    def add(self) -> Pose:
        """Track the image in the current slot."""
        here = _Placed(self.registrar.prepare(self._free()), self._frames)
        self._frames += 1
        if self._key is None:
            self._key = self._last = here
            pose = Pose(self._segment, 0.0, 0.0, AT_REST, nan, nan, State.TRACKED)
        else:
            pose = self._continue(here) or self._restart(here) or self._coast(here)
        self._previous = here
        return pose

    def _free(self) -> View:
        taken = [placed.view for placed in (self._key, self._last, self._previous) if placed is not None]
        return next(view for view in self._slots if not any(view is other for other in taken))

    def _continue(self, here: _Placed) -> Pose | None:
        """Link a frame to the key frame of the segment, or to the last frame that was."""
        key, last = self._key, self._last
        assert key is not None
        assert last is not None
        if hypot(*self._expected(key, here.index)) > KEY_FRAME_REACH * self.grid.diameter:
            key = self._key = last
        if hypot(*self._expected(key, here.index)) > FARTHEST * self.grid.diameter:
            return None
        link = self._link(key, here)
        if link is None:
            return None
        self._place(key, here, link)
        return self._track(here, link)

    def _restart(self, here: _Placed) -> Pose | None:
        """Start a new segment from the frame before, which itself has no place, if the two can be linked."""
        previous, last = self._previous, self._last
        assert previous is not None
        if previous is last:
            return None
        before = self._motion, self._usual
        self._motion, self._usual = Motion(self.grid.shutter), nan
        origin = _Placed(previous.view, previous.index)
        link = self._link(origin, here)
        if link is None:
            self._motion, self._usual = before
            return None
        self._place(origin, here, link)
        here.row = here.col = 0.0
        self._key = here
        self._segment += 1
        return self._track(here, link)

    def _coast(self, here: _Placed) -> Pose:
        """Predict a frame that cannot be linked, or give the track up."""
        key, last = self._key, self._last
        assert key is not None
        assert last is not None
        ahead = self._expected(last, here.index)
        gone = here.index - last.index > PATIENCE_FRAMES or hypot(*ahead) > FARTHEST * self.grid.diameter
        if gone or not self._motion.known:
            return Pose(self._segment, nan, nan, Velocity(nan, nan), nan, nan, State.LOST)
        velocity = self._motion.next_velocity
        return Pose(self._segment, last.row + ahead.row, last.col + ahead.col, velocity, nan, nan, State.PREDICTED)

    def _expected(self, earlier: _Placed, index: int) -> Displacement:
        """Displacement from a placed frame that the motion so far suggests."""
        last = self._last
        assert last is not None
        if not self._motion.known:
            return Displacement(0.0, 0.0)
        ahead = self._motion.ahead(index - last.index)
        return Displacement(last.row - earlier.row + ahead.row, last.col - earlier.col + ahead.col)

    def _link(self, earlier: _Placed, here: _Placed) -> Link | None:
        """Link two frames, first where the motion suggests it, else anywhere; None if the frames do not say where."""
        shutter, motion = self.grid.shutter, self._motion
        expected = shutter.warp(earlier.velocity, motion.next_velocity, self._expected(earlier, here.index))
        spread = (motion.spread / shutter.rows_per_frame + 1e-9,) * 2
        last = self._last
        assert last is not None
        reach = _FIRST_REACH * self.grid.diameter
        if motion.known:
            link = self.registrar.link(earlier.view, here.view, expected, spread)
            if link.correlation > SURE_CORRELATION and self._accepted(link, here):
                return link
            reach = _REACH_PX * (here.index - last.index)
        found = self.registrar.search(earlier.view, here.view, expected, spread, reach)
        return found if found is not None and self._accepted(found, here) else None

    def _accepted(self, link: Link, here: _Placed) -> bool:
        """Whether the frames single out this shift, and agree about as well as frames did so far.

        After a gap less is known beforehand, so that the frames themselves must say more.
        """
        assert self._last is not None
        gap = here.index - self._last.index if self._motion.known else 1
        usual = not link.correlation < self._usual - FALL_OF_CORRELATION
        needed = gap * LEAST_EVIDENCE * max(1.0, self._motion.spread / SMOOTH_MOTION_PX)
        return link.observed and link.evidence >= needed and usual

    def _place(self, earlier: _Placed, here: _Placed, link: Link) -> None:
        """Give a frame its position and velocity."""
        shutter = self.grid.shutter
        if here.index == earlier.index + 1:
            before, after = shutter.velocities(link.warp)
            if not self._motion.known:
                earlier.velocity = before
        else:
            after = self._velocity_after_gap(earlier, here, link)
        moved = shutter.displacement(link.warp, after)
        here.row, here.col, here.velocity = earlier.row + moved.row, earlier.col + moved.col, after
        self.links.append((earlier.index, here.index, moved, link))

    def _velocity_after_gap(self, earlier: _Placed, here: _Placed, link: Link) -> Velocity:
        """Velocity of a frame linked to one some frames before: from its shear, or from where it came to lie."""
        shutter, motion, last = self.grid.shutter, self._motion, self._last
        assert last is not None
        moved = shutter.displacement(link.warp, motion.next_velocity)
        gap = here.index - last.index
        along = Velocity((earlier.row + moved.row - last.row) / gap, (earlier.col + moved.col - last.col) / gap)
        if not isfinite(shutter.rows_per_frame):
            return along
        sheared = shutter.later_velocity(link.warp, earlier.velocity)
        doubt = shutter.rows_per_frame**2 * np.diag(np.linalg.inv(link.information))[[0, 2]] + _VELOCITY_SIGMA**2
        part = (gap * motion.surprise / 2) ** 2 / ((gap * motion.surprise / 2) ** 2 + doubt)
        return Velocity(*(np.array(along) + part * (np.array(sheared) - along)).tolist())

    def _track(self, here: _Placed, link: Link) -> Pose:
        last = self._last
        assert last is not None
        self._motion.follow(here.velocity, successive=here.index - last.index == 1)
        self._last = here
        known = isfinite(self._usual)
        self._usual = self._usual + _MEMORY * (link.correlation - self._usual) if known else link.correlation
        return Pose(self._segment, here.row, here.col, here.velocity, link.correlation, link.sigma, State.TRACKED)
