"""Frame after frame: where the probe is, how well that is known, and when it is not.

Each frame is linked to a key frame that is renewed before the overlap shrinks: at fast motion that is the frame
before, at slow motion one key frame serves many frames, so that errors do not add up. The link starts from the motion
so far; it is kept only if the frames themselves single out its shift, and otherwise sought among all shifts. Frames
that no link reaches are predicted for a while, then lost; a new segment starts where frames can be linked again.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from math import hypot, nan
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from napari_elsplus.processing.motion import Displacement, Velocity
from napari_elsplus.processing.registration import Link, Registrar, View

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.processing.frontend import Grid

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


_AT_REST: Final = Velocity(0.0, 0.0)


@dataclass(slots=True)
class _Placed:
    """A frame that others can be linked to."""

    view: View
    index: int = -1
    row: float = 0.0
    col: float = 0.0
    velocity: Velocity = _AT_REST


class Tracker:
    """Tracks the probe through a sequence of tracking images.

    Parameters
    ----------
    grid : Grid
        The grid of the images, with the timing of its rows.

    Attributes
    ----------
    links : list of tuple
        (earlier frame, later frame, displacement, covariance) of every accepted link.
    """

    def __init__(self, grid: Grid) -> None:
        self.grid = grid
        self.registrar = Registrar(grid)
        self._slots = [self.registrar.view() for _ in range(4)]
        self._key: _Placed | None = None
        self._previous: _Placed | None = None
        self._velocity = Velocity(0.0, 0.0)
        self._moving = False
        self._segment = 0
        self._frames = 0
        self._missed = 0
        self.links: list[tuple[int, int, Displacement, Link]] = []

    def slot(self) -> NDArray[np.float32]:
        """Return the array into which the next image is to be written before :meth:`add` is called."""
        return self._free().image

    def add(self) -> Pose:
        """Track the image in the current slot."""
        view = self.registrar.prepare(self._free())
        index = self._frames
        self._frames += 1
        here = _Placed(view, index)
        if self._key is None:
            point = self._begin(here)
        else:
            point = self._continue(here) or self._restart(here) or self._coast(here)
        self._previous = here
        return point

    def _free(self) -> View:
        taken = [placed.view for placed in (self._key, self._previous) if placed is not None]
        return next(view for view in self._slots if not any(view is other for other in taken))

    def _begin(self, here: _Placed) -> Pose:
        self._key, self._missed = here, 0
        return Pose(self._segment, 0.0, 0.0, here.velocity, nan, nan, State.TRACKED)

    def _continue(self, here: _Placed) -> Pose | None:
        """Link a frame to the key frame of the segment."""
        key, previous = self._key, self._previous
        assert key is not None
        assert previous is not None
        if self._missed == 0 and key is not previous:
            step = self.grid.shutter.step(self._velocity, self._velocity)
            ahead = hypot(previous.row + step.row - key.row, previous.col + step.col - key.col)
            if ahead > KEY_FRAME_REACH * self.grid.diameter:
                key = self._key = previous
        if hypot(*self._expected(key, here.index)) > FARTHEST * self.grid.diameter:
            return None
        link = self._link(key, here)
        if link is None:
            return None
        self._place_by(key, here, link)
        if self._missed:
            self._key = here
        self._missed = 0
        self._moving = True
        self._velocity = here.velocity
        return self._point(here, link, State.TRACKED)

    def _restart(self, here: _Placed) -> Pose | None:
        """Start a new segment from the frame before, which itself has no place, if the two can be linked."""
        previous = self._previous
        assert previous is not None
        if self._missed == 0:
            return None
        origin = _Placed(previous.view, previous.index)
        link = self._link(origin, here, blind=True)
        if link is None:
            return None
        self._place_by(origin, here, link)
        here.row = here.col = 0.0
        self._key, self._missed, self._moving = here, 0, True
        self._segment += 1
        self._velocity = here.velocity
        return self._point(here, link, State.TRACKED)

    def _coast(self, here: _Placed) -> Pose:
        """Predict a frame that cannot be linked, or give the track up."""
        self._missed += 1
        key = self._key
        assert key is not None
        ahead = self._expected(key, here.index)
        here.velocity = self._velocity
        here.row, here.col = key.row + ahead.row, key.col + ahead.col
        if self._missed > PATIENCE_FRAMES or hypot(*ahead) > FARTHEST * self.grid.diameter:
            return Pose(self._segment, nan, nan, Velocity(nan, nan), nan, nan, State.LOST)
        return Pose(self._segment, here.row, here.col, here.velocity, nan, nan, State.PREDICTED)

    def _expected(self, key: _Placed, index: int) -> Displacement:
        """Displacement from the key frame that a steady motion since the last tracked frame suggests."""
        v = self._velocity
        if self._missed == 0 and self._previous is not None:
            return Displacement(self._previous.row - key.row + v.row, self._previous.col - key.col + v.col)
        apart = index - key.index
        return Displacement(apart * v.row, apart * v.col)

    def _link(self, earlier: _Placed, here: _Placed, *, blind: bool = False) -> Link | None:
        """Link two frames, first where the motion suggests it, else anywhere; None if the frames do not say where."""
        shutter = self.grid.shutter
        velocity = Velocity(0.0, 0.0) if blind else self._velocity
        before = velocity if blind else earlier.velocity
        ahead = Displacement(0.0, 0.0) if blind else self._expected(earlier, here.index)
        expected = shutter.warp(before, velocity, ahead)
        change = 3.0 + 0.1 * hypot(*velocity)
        spread = (change / shutter.rows_per_frame + 1e-9,) * 2
        if self._moving and not blind:
            link = self.registrar.link(earlier.view, here.view, expected, spread)
            if link.observed and link.correlation > 0.9:
                return link
        reach = 0.3 * self.grid.diameter if blind or not self._moving else 8.0 * (1 + self._missed)
        found = self.registrar.search(earlier.view, here.view, expected, spread, reach)
        return found if found is not None and found.observed else None

    def _place_by(self, earlier: _Placed, here: _Placed, link: Link) -> None:
        shutter = self.grid.shutter
        apart = here.index - earlier.index
        if apart == 1:
            before, after = shutter.velocities(link.warp)
            if not self._moving:
                earlier.velocity = before
        else:
            after = shutter.steady(link.warp, apart)
            previous = self._previous
            if self._missed == 0 and previous is not None:
                shift = shutter.displacement(link.warp, self._velocity)
                after = Velocity(earlier.row + shift.row - previous.row, earlier.col + shift.col - previous.col)
        moved = shutter.displacement(link.warp, after)
        here.row, here.col, here.velocity = earlier.row + moved.row, earlier.col + moved.col, after
        self.links.append((earlier.index, here.index, moved, link))

    def _point(self, here: _Placed, link: Link, state: State) -> Pose:
        sigma = float(np.sqrt(np.linalg.eigvalsh(link.covariance)[-1]))
        return Pose(self._segment, here.row, here.col, here.velocity, link.correlation, sigma, state)
