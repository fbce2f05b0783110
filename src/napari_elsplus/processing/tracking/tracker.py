"""Frame after frame: where the probe is, how well that is known, and when it is not.

Each frame is linked to a key frame that is renewed before the overlap shrinks: at fast motion that is the frame
before, at slow motion one key frame serves many frames, so that errors do not add up. The link starts from the motion
so far; it is kept only if the frames themselves single out its shift, and otherwise sought among all shifts. Frames
that no link reaches are predicted for a while, then lost; a new segment starts where frames can be linked again.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot, inf, isfinite, nan
from typing import TYPE_CHECKING, Final

from napari_elsplus.processing.tracking.motion.pose import Pose, TrackingState
from napari_elsplus.processing.tracking.motion.prediction import AT_REST, Motion, Turning, needed_times, unevenly
from napari_elsplus.processing.tracking.motion.rolling_shutter import Displacement, Velocity
from napari_elsplus.processing.tracking.motion.warp_prior import WarpPrior, velocity_sigma, warp_prior
from napari_elsplus.processing.tracking.registration.evidence import stretch_and_shear_variance
from napari_elsplus.processing.tracking.registration.low_texture import DOUBT, LowTextureFallback, unlit
from napari_elsplus.processing.tracking.registration.model_selection import ModelSelection
from napari_elsplus.processing.tracking.registration.motion_models import MotionModel, turned_by
from napari_elsplus.processing.tracking.registration.pair_registration import PairRegistration, PreparedFrame, Registrar

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.front_end.grid import Grid

KEY_FRAME_REACH: Final = 0.1
"""Displacement from the key frame, in bundle diameters, at which it is renewed."""
PATIENCE_FRAMES: Final = 5
"""Frames without a link that are predicted before the track is lost."""
FARTHEST: Final = 0.6
"""Predicted displacement, in bundle diameters, beyond which no link is tried."""
SURE_CORRELATION: Final = 0.9
"""Correlation below which a predicted link is compared with all other shifts."""
MOST_UNEVEN_PX: Final = 0.7
"""Error of a displacement from uneven motion within the frames, up to which a link is used."""
FALL_OF_CORRELATION: Final = 0.08
"""How far a link's correlation may lie below what was usual so far."""
_MEMORY: Final = 0.2
_RISE_OF_CORRELATION: Final = 0.03
_ASK_EVERY: Final = 4
"""Frames between two questions whether the probe turns, as long as it does not."""
_ASK_AT_REST: Final = 32
"""The same, while one key frame serves."""
_VELOCITY_SIGMA: Final = 0.3
"""What the velocity of a linked frame is trusted to."""
_REACH_PX: Final = 8.0
_FIRST_REACH: Final = 0.3


@dataclass(slots=True)
class _Placed:
    """A frame that others can be linked to."""

    view: PreparedFrame
    index: int = -1
    row: float = 0.0
    col: float = 0.0
    velocity: Velocity = AT_REST
    angle: float = 0.0
    scale: float = 1.0
    told_by: PairRegistration | None = None
    """The link to the frame before, which tells the velocity; None if it was made otherwise."""
    velocity_sigma: float = inf
    """What the velocity is trusted to if no such link tells."""


class Tracker:
    """Tracks the probe through a sequence of tracking images.

    Parameters
    ----------
    grid : Grid
        The grid of the images, with the timing of its rows.

    Attributes
    ----------
    links : list of tuple
        (earlier frame, later frame, displacement in the later one's orientation, link) of every accepted link.
    """

    def __init__(self, grid: Grid) -> None:
        self.grid = grid
        self.registrar = Registrar(grid)
        self.links: list[tuple[int, int, Displacement, PairRegistration]] = []
        self._second = LowTextureFallback(self.registrar)
        self._slots = [self.registrar.view() for _ in range(4)]
        self._scratch = self.registrar.view()
        self._climb = ModelSelection()
        self._newest: PairRegistration | None = None
        self._asked = 0
        self._began = self._covered = 0
        self._turned = 0.0
        self._turning = Turning()
        self._uneven = 0.0
        self._motion = Motion(grid.shutter)
        self._key: _Placed | None = None
        self._last: _Placed | None = None
        self._previous: _Placed | None = None
        self._usual = nan
        self._segment = 0
        self._frames = 0
        self._coming = self._free()

    @property
    def rung(self) -> MotionModel:
        """What the frames have asked for so far, beside translations."""
        return self._climb.rung

    def slot(self) -> NDArray[np.float32]:
        """Return the array into which the next image is to be written before :meth:`add` is called."""
        return self._coming.image

    def add(self) -> Pose:
        """Track the image in the current slot."""
        here = _Placed(self.registrar.prepare(self._coming), self._frames)
        self._frames += 1
        if self._key is None:
            self._key = self._last = here
            pose = Pose(self._segment, 0.0, 0.0, AT_REST, nan, nan, TrackingState.TRACKED)
        else:
            pose = self._continue(here) or self._restart(here) or self._coast(here)
        self._previous = here
        self._coming = self._free()
        return pose

    def _free(self) -> PreparedFrame:
        taken = [placed.view for placed in (self._key, self._last, self._previous) if placed is not None]
        return next(view for view in self._slots if not any(view is other for other in taken))

    def _continue(self, here: _Placed) -> Pose | None:
        """Register a frame to the key frame of the segment, or to the last frame that was."""
        key, last = self._key, self._last
        assert key is not None
        assert last is not None
        ahead = self._expected(key, here.index)
        renew = hypot(*ahead) > KEY_FRAME_REACH * self.grid.diameter
        if self.rung is MotionModel.TRANSLATION:
            self._ask(renew=renew)
        if renew:
            key = self._key = last
        if renew or self.rung is not MotionModel.TRANSLATION:
            ahead = self._expected(key, here.index)
        if hypot(*ahead) > FARTHEST * self.grid.diameter:
            return None
        link = self._link(key, here, ahead)
        if link is None:
            return None
        return self._track(here, link) if self._place(key, here, link) else None

    def _restart(self, here: _Placed) -> Pose | None:
        """Start a new segment from the frame before, which itself has no place, if the two can be linked."""
        previous, last = self._previous, self._last
        assert previous is not None
        if previous is last:
            return None
        before = self._motion, self._usual
        self._motion, self._usual = Motion(self.grid.shutter), nan
        origin = _Placed(previous.view, previous.index)
        link = self._link(origin, here, self._expected(origin, here.index))
        if link is None or not self._place(origin, here, link):
            self._motion, self._usual = before
            return None
        here.row = here.col = here.angle = 0.0
        here.scale = 1.0
        self._key = here
        self._segment += 1
        self._began = self._asked = here.index
        self._covered, self._turned = 0, 0.0
        return self._track(here, link)

    def _coast(self, here: _Placed) -> Pose:
        """Predict a frame that cannot be linked, or give the track up."""
        key, last = self._key, self._last
        assert key is not None
        assert last is not None
        ahead = self._expected(last, here.index)
        gone = here.index - last.index > PATIENCE_FRAMES or hypot(*ahead) > FARTHEST * self.grid.diameter
        if gone or not self._motion.known:
            return Pose(self._segment, nan, nan, Velocity(nan, nan), nan, nan, TrackingState.LOST)
        row, col = turned_by(last.angle, last.scale) @ ahead
        return Pose(
            self._segment, last.row + float(row), last.col + float(col), self._motion.next_velocity, nan, nan,
            TrackingState.PREDICTED, last.angle, last.scale,
        )  # fmt: skip

    def _ask(self, *, renew: bool) -> None:
        """Ask, now and then, whether the frames since the key frame have turned, and from when on that is modelled."""
        key, last, link = self._key, self._last, self._newest
        assert key is not None
        assert last is not None
        wait = _ASK_EVERY if renew else _ASK_AT_REST
        if renew and link is not None and isfinite(link.again):
            wait = 1
        if link is None or not link.tells_turn or last is key or last.index - self._asked < wait:
            return
        self._asked = last.index
        found = self.registrar.remainder(key.view, last.view, link.warp, self._spread)
        if found is None:
            return
        apart, turn = last.index - key.index, -float(found.step[MotionModel.RIGID, 4])
        rung = self._climb.weigh(found, keep=renew)
        covered, turned = self._covered + apart, self._turned + turn
        if rung is not MotionModel.TRANSLATION:
            self._turning.rate = turned / covered
            last.angle = self._turning.rate * (last.index - self._began)
            key.angle = last.angle - turn
        elif renew:
            self._covered, self._turned = covered, turned

    def _expected(self, earlier: _Placed, index: int) -> Displacement:
        """Displacement from a placed frame that the motion so far suggests, in the orientation of the last one."""
        last = self._last
        assert last is not None
        if not self._motion.known:
            return Displacement(0.0, 0.0)
        ahead = self._motion.ahead(index - last.index)
        gone = last.row - earlier.row, last.col - earlier.col
        if self.rung is not MotionModel.TRANSLATION:
            row, col = turned_by(-last.angle, 1 / last.scale) @ gone
            gone = float(row), float(col)
        return Displacement(gone[0] + ahead.row, gone[1] + ahead.col)

    @property
    def _spread(self) -> tuple[float, float]:
        """Standard deviations of stretch and shear about what the motion so far suggests."""
        return (self._motion.spread / self.grid.shutter.line_periods_per_frame + 1e-9,) * 2

    def _link(self, earlier: _Placed, here: _Placed, ahead: Displacement) -> PairRegistration | None:
        """Register two frames, first where it is expected ahead, else anywhere; None if the frames do not say where."""
        if self.rung is not MotionModel.TRANSLATION:
            return self._turned_link(earlier, here, ahead, self.rung)
        expected = self.grid.shutter.warp(earlier.velocity, self._motion.next_velocity, ahead)
        if self._motion.known:
            link = self.registrar.link(earlier.view, here.view, expected, self._spread)
            if link.evidence < DOUBT:
                link = self._second.link(earlier.view, here.view, self._known(earlier, here, ahead)) or unlit(link)
            if link.correlation > SURE_CORRELATION and self._accepted(link, here):
                return link
            turned = self._suddenly_turned(earlier, here, ahead, link)
            if turned is not None:
                return turned
        found = self.registrar.search(earlier.view, here.view, expected, self._spread, self._reach(here))
        if found is not None and found.evidence < DOUBT:
            known = self._known(earlier, here, ahead)
            again = self._second.search(earlier.view, here.view, known, self._reach(here)) or unlit(found)
            if not self._motion.known and not found.stands(needed_times(self._motion.spread)):
                return None
            found = again
        if found is None or not self._accepted(found, here):
            return None
        turned = None if found.correlation > SURE_CORRELATION else self._suddenly_turned(earlier, here, ahead, found)
        return turned or found

    def _known(self, earlier: _Placed, here: _Placed, ahead: Displacement) -> WarpPrior:
        """Return what the motion so far tells of the warp between two frames."""
        motion = self._motion
        velocities = earlier.velocity, motion.next_velocity
        return warp_prior(self.grid.shutter, velocities, ahead, motion.spread, self._trust(here))

    def _trust(self, here: _Placed) -> float | None:
        """How well the velocity before a frame is known; None if there was no link just before."""
        last = self._last
        assert last is not None
        if not self._motion.known or here.index - last.index > 1:
            return None
        told = last.told_by
        sigma = last.velocity_sigma if told is None else velocity_sigma(told.information, self.grid.shutter)
        return hypot(sigma, unevenly(self._motion.surprise))

    def _reach(self, here: _Placed) -> float:
        """How far the shift may well be from what is expected."""
        assert self._last is not None
        return _REACH_PX * (here.index - self._last.index) if self._motion.known else _FIRST_REACH * self.grid.diameter

    def _suddenly_turned(
        self, earlier: _Placed, here: _Placed, ahead: Displacement, link: PairRegistration
    ) -> PairRegistration | None:
        """Try, where frames agree less than they should, whether they do once one is turned."""
        found = self.registrar.remainder(earlier.view, here.view, link.warp, self._spread)
        if found is None or not ModelSelection().weigh(found):
            return None
        turned = self._turned_link(earlier, here, ahead, MotionModel.RIGID)
        if turned is None or not turned.correlation > max(link.correlation + _RISE_OF_CORRELATION, SURE_CORRELATION):
            return None
        self._climb.rung = MotionModel.RIGID
        return turned

    def _turned_link(
        self, earlier: _Placed, here: _Placed, ahead: Displacement, rung: MotionModel
    ) -> PairRegistration | None:
        """Register two frames of a probe that turns."""
        last, motion = self._last, self._motion
        assert last is not None
        turn = last.angle - earlier.angle + self._turning.rate * (here.index - last.index) if motion.known else 0.0
        zoom = last.scale / earlier.scale if motion.known else 1.0
        trust = self._trust(here) if earlier is last else None
        spread = self._turning.spread(here.index - last.index) if motion.known and self.rung is rung else inf
        for reach in (None, self._reach(here)) if motion.known else (self._reach(here),):
            link = self.registrar.turned_link(
                earlier.view, here.view, (ahead.row, ahead.col, turn, zoom), (earlier.velocity, motion.next_velocity),
                self._spread, rung, self._scratch, reach, spread,
            )  # fmt: skip
            if link is not None:
                velocities = earlier.velocity, motion.next_velocity
                link = self._second.confirmed(
                    link, earlier.view, here.view, velocities, motion.spread, self._scratch, trust
                )
            if link is not None and self._accepted(link, here) and (reach or link.correlation > SURE_CORRELATION):
                return link
        return None

    def _accepted(self, link: PairRegistration, here: _Placed) -> bool:
        """Whether the frames single out this shift, and agree about as well as frames did so far.

        After a gap less is known beforehand, so that the frames themselves must say more.
        """
        assert self._last is not None
        gap = here.index - self._last.index if self._motion.known else 1
        usual = not link.correlation < self._usual - FALL_OF_CORRELATION
        return usual and link.stands(gap if isfinite(link.again) else gap * needed_times(self._motion.spread))

    def _place(self, earlier: _Placed, here: _Placed, link: PairRegistration) -> bool:
        """Give a frame its position and velocity; refuse if the probe moved too unevenly for the link to say so."""
        shutter, last = self.grid.shutter, self._last
        assert last is not None
        if here.index == earlier.index + 1:
            before, after = shutter.velocities(link.warp)
            here.told_by = link
        else:
            after, here.velocity_sigma = self._velocity_after_gap(earlier, here, link)
            before = after
        successive = here.index - last.index == 1 or not self._motion.known
        self._uneven = self._motion.unevenness(before, after, successive=successive)
        if self._uneven > MOST_UNEVEN_PX:
            return False
        if not self._motion.known:
            earlier.velocity = before
        moved = shutter.displacement(link.warp, after)
        here.angle, here.scale, here.velocity = earlier.angle + link.turn, earlier.scale * link.zoom, after
        row, col = moved if self.rung is MotionModel.TRANSLATION else turned_by(here.angle, here.scale) @ moved
        here.row, here.col = earlier.row + float(row), earlier.col + float(col)
        self.links.append((earlier.index, here.index, moved, link))
        return True

    def _velocity_after_gap(self, earlier: _Placed, here: _Placed, link: PairRegistration) -> tuple[Velocity, float]:
        """Velocity of a frame linked to one some frames before: from its shear, or from where it came to lie."""
        shutter, motion, last = self.grid.shutter, self._motion, self._last
        assert last is not None
        moved = shutter.displacement(link.warp, motion.next_velocity)
        gap = here.index - last.index
        gone = Displacement(last.row - earlier.row, last.col - earlier.col)
        if self.rung is not MotionModel.TRANSLATION:
            gone = Displacement(*(turned_by(-last.angle, 1 / last.scale) @ gone).tolist())
        along = Velocity((moved.row - gone.row) / gap, (moved.col - gone.col) / gap)
        if not isfinite(shutter.line_periods_per_frame):
            return along, inf
        sheared = shutter.later_velocity(link.warp, earlier.velocity)
        stretch, shear = stretch_and_shear_variance(link.information)
        surprise = (gap * motion.surprise / 2) ** 2
        unsure = [shutter.line_periods_per_frame**2 * variance + _VELOCITY_SIGMA**2 for variance in (stretch, shear)]
        parts = [surprise / (surprise + variance) for variance in unsure]
        velocity = Velocity(*(v + part * (w - v) for v, w, part in zip(along, sheared, parts, strict=True)))
        return velocity, max(part * variance for part, variance in zip(parts, unsure, strict=True)) ** 0.5

    def _track(self, here: _Placed, link: PairRegistration) -> Pose:
        last = self._last
        assert last is not None
        gap = here.index - last.index
        if self.rung is not MotionModel.TRANSLATION:
            self._turning.follow(here.angle - last.angle, gap)
        self._motion.follow(here.velocity, successive=gap == 1)
        self._last, self._newest = here, link
        known = isfinite(self._usual)
        self._usual = self._usual + _MEMORY * (link.correlation - self._usual) if known else link.correlation
        sigma = hypot(link.sigma, self._uneven)
        return Pose(
            self._segment, here.row, here.col, here.velocity, link.correlation, sigma, TrackingState.TRACKED,
            here.angle, here.scale,
        )  # fmt: skip
