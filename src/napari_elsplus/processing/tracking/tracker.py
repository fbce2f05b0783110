"""Frame-to-frame tracking: the pose of the probe, its uncertainty, and its state.

Each frame is linked to a key frame that is renewed before the overlap shrinks: at fast motion that is the frame
before, at slow motion one key frame serves many frames, so that errors do not add up. The link starts from the motion
so far; it is accepted by its posterior odds, and otherwise sought among all shifts. Frames
that no link reaches are predicted for a while, then lost; a new segment starts where frames can be linked again.
"""

from __future__ import annotations

from cmath import rect
from dataclasses import dataclass
from math import hypot, isnan, nan
from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.processing.tracking.front_end.grid import FIELD
from napari_elsplus.processing.tracking.motion.pose import Pose, TrackingState
from napari_elsplus.processing.tracking.motion.prediction import AT_REST, MIN_SHARE, MIN_SHARE_TURNING, Motion, Turning
from napari_elsplus.processing.tracking.motion.rolling_shutter import Displacement, Velocity
from napari_elsplus.processing.tracking.registration.motion_models import ModelSelection, MotionModel, selected_model
from napari_elsplus.processing.tracking.registration.pair_registration import (
    MIN_ODDS_NATS,
    PairRegistration,
    TrackedPair,
    Turn,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.motion.motion_prior import MotionPrior
    from napari_elsplus.processing.tracking.registration.pair_registration import PreparedFrame, Registrar

KEY_FRAME_REACH: Final = 0.1
"""Displacement from the key frame, in bundle diameters, at which it is renewed."""
PATIENCE_FRAMES: Final = 5
"""Frames without a link that are predicted before the track is lost."""
MAX_DISPLACEMENT_DIAMETERS: Final = 0.6
"""Predicted displacement, in bundle diameters, beyond which no link is tried."""
_MEMORY: Final = 0.2
_TEST_EVERY: Final = 3
"""Frame periods between two score tests for rotation, as long as none is found; chosen on 96 recordings of probes that
begin to turn: with 2 a frame takes 3 % longer, with 4 turns are found later."""
_UNEVEN_PX: Final = 0.2
"""Standard deviation of a displacement by uneven motion, pixels, from which that is estimated; chosen: a third of the
largest that is accepted."""
_LARGE_TURN: Final = 0.07
"""Rotation between first frames, radians, at which one is sought that is too large to be measured from none; chosen."""
_WAITING_ODDS_NATS: Final = 0.0
"""Odds from which a first registration waits for the next one: it is more probable than not."""


@dataclass(slots=True)
class _Placed:
    """A frame that others can be linked to: the `index`-th that was added, taken in the `period`-th frame period."""

    view: PreparedFrame
    index: int = -1
    period: int = -1
    at: complex = 0j
    velocity: Velocity = AT_REST
    angle: float = 0.0
    velocity_variance: float = 0.0
    sigma: float = nan


@dataclass(slots=True)
class _Start:
    """A registration that begins a segment if the next one agrees with it."""

    found: TrackedPair
    later: _Placed
    motion: Motion


class Tracker:
    """Tracks the probe through a sequence of tracking images.

    Parameters
    ----------
    registrar : Registrar
        Registers two frames.
    turn_rate : float, optional
        Rotation of the probe at first, radians per frame, if it is modelled from the first frame on.

    Attributes
    ----------
    links : list of TrackedPair
        All registrations that were accepted.
    lost : dict of int to int
        How many frames were lost before some, by the count of those that were added.
    """

    def __init__(self, registrar: Registrar, turn_rate: float | None = None) -> None:
        self.registrar, self.grid = registrar, registrar.grid
        self._max_displacement_px = MAX_DISPLACEMENT_DIAMETERS * self.grid.diameter
        self._middle_px2 = (FIELD * self.grid.diameter / 4) ** 2
        self.links: list[TrackedPair] = []
        self.lost: dict[int, int] = {}
        self._slots = [self.registrar.view() for _ in range(4)]
        self._selection = ModelSelection(MotionModel.TRANSLATION if turn_rate is None else MotionModel.RIGID)
        self._newest: PairRegistration | None = None
        self._tested = self._began = self._covered = 0
        self._turned = 0.0
        self._turning = Turning(turn_rate or 0.0)
        self._motion = Motion(self.grid.shutter, FIELD * self.grid.diameter)
        self._key = self._last = self._previous = _Placed(self._slots[0])
        self._usual = nan
        self._start: _Start | None = None
        self._segment = self._frames = self._periods = 0
        self._coming = self._free()

    @property
    def model(self) -> MotionModel:
        """Motion model selected so far, beside translations."""
        return self._selection.model

    @property
    def turn_rate(self) -> float | None:
        """Rotation of the probe, radians per frame; None as long as none is modelled."""
        return None if self.model is MotionModel.TRANSLATION else self._turning.rate

    def slot(self) -> NDArray[np.float32]:
        """Return the array into which the next image is to be written before :meth:`add` is called."""
        return self._coming.image

    def skip(self, frames: int) -> None:
        """Take note that frames were lost before the next one, while the probe went on moving.

        Parameters
        ----------
        frames : int
            Frame periods without a frame; 0 if none was lost.
        """
        if frames:
            self._periods += frames
            self.lost[self._frames] = self.lost.get(self._frames, 0) + frames

    def add(self) -> Pose:
        """Track the image in the current slot."""
        self._coming.renew()
        here = _Placed(self._coming, self._frames, self._periods)
        self._frames += 1
        self._periods += 1
        if here.index == 0:
            self._key = self._last = here
            pose = Pose(self._segment, 0.0, 0.0, AT_REST, nan, nan, TrackingState.TRACKED)
        else:
            pose = self._register(here) or self._coast(here)
        self._previous = here
        self._coming = self._free()
        return pose

    def _free(self) -> PreparedFrame:
        key, last, previous = self._key.view, self._last.view, self._previous.view
        for view in self._slots:  # one more than are taken
            if view is not key and view is not last and view is not previous:
                break
        return view

    def _register(self, here: _Placed) -> Pose | None:
        """Register a frame to the segment, else to the frame before; once the track is lost, to either in turn.

        So a lost frame costs one search, not two, and the track is found again half a frame later on average. Where a
        start waits, it is tested first.
        """
        last = self._last
        if self._previous is last or here.period - last.period <= PATIENCE_FRAMES:
            return self._continue(here) or self._restart(here)
        reachable = hypot(*self._expected(last, here.period)) <= self._max_displacement_px
        continues = here.index % 2 and reachable and self._start is None
        return self._continue(here) if continues else self._restart(here)

    def _continue(self, here: _Placed) -> Pose | None:
        """Register a frame to the key frame of the segment, or to the last frame that was."""
        key, last = self._key, self._last
        ahead = self._expected(key, here.period)
        rigid = not self._usual < self.registrar.rigid_correlation
        renew = hypot(*ahead) > (KEY_FRAME_REACH * self.grid.diameter if rigid else 0.0)
        if self.registrar.registers_warps and self.model is MotionModel.TRANSLATION:
            self._test_rotation(renew=renew)
        if renew:
            key = self._key = last
            ahead = self._motion.ahead(here.period - last.period)
        elif self.model is not MotionModel.TRANSLATION:
            ahead = self._expected(key, here.period)
        if hypot(*ahead) > self._max_displacement_px:
            return None
        motion = self._prior(key, here, ahead)
        link = self._link(key, here, motion)
        return self._track(here, link) if link is not None and self._place(key, here, link, motion) else None

    def _restart(self, here: _Placed) -> Pose | None:
        """Begin a segment with a frame once it can be registered to the one before, which itself has no place."""
        previous, start = self._previous, self._start
        self._start = None
        if previous is self._last and self._motion.known:
            return None
        before = self._motion, self._turning, self._key, self._last
        pose = self._confirm(start, here) if start is not None and start.later is previous else None
        pose = pose or self._start_at(previous, here)
        if pose is None:
            self._motion, self._turning, self._key, self._last = before
        return pose

    def _start_at(self, previous: _Placed, here: _Placed) -> Pose | None:
        """Begin a segment under the widest prior; where the odds do not suffice the registration waits for the next."""
        self._motion, self._turning = self._motion.forgotten(), Turning(self._turning.rate, self._turning.surprise)
        self._key = self._last = origin = _Placed(previous.view, previous.index, previous.period)
        motion = self._widest(here.period - previous.period)
        least = _WAITING_ODDS_NATS if self.model is MotionModel.TRANSLATION else MIN_ODDS_NATS
        link = self._link(origin, here, motion, least)
        if link is None or not self._place(origin, here, link, motion):
            return None
        if link.observed:
            return self._begin(here, link)
        self._start = _Start(self.links.pop(), here, self._motion)
        return None

    def _confirm(self, start: _Start, here: _Placed) -> Pose | None:
        """Begin a segment with a registration that waited, if this frame's, by its motion, raises its odds enough.

        They rise by how much more probable the shift is by that motion than under the widest prior; the frames of both
        correlate alike.
        """
        self._motion, self._key, self._last = start.motion, start.later, start.later
        motion = self._prior(start.later, here, self._expected(start.later, here.period))
        link, waited = self._link(start.later, here, motion), start.found.registration
        if link is None or abs(link.at_half - waited.at_half) > self.registrar.fall_of_correlation:
            return None
        _, b, _, d = link.warp
        rise = motion.log_density(b, d) - self._widest(here.period - start.later.period).log_density(b, d)
        if waited.odds + rise < MIN_ODDS_NATS or not self._place(start.later, here, link, motion):
            return None
        self.links.insert(-1, start.found)
        return self._begin(here, link)

    def _widest(self, periods: int) -> MotionPrior:
        """Return the prior of the motion between frames so many periods apart where no velocity is known."""
        return self._motion.forgotten().prior(Displacement(0.0, 0.0), periods)

    def _begin(self, here: _Placed, link: PairRegistration) -> Pose:
        """Begin a segment with a frame that was placed."""
        here.at, here.angle = 0j, 0.0
        self._key = here
        self._segment += 1
        self._began = self._tested = here.period
        self._covered, self._turned = 0, 0.0
        return self._track(here, link)

    def _coast(self, here: _Placed) -> Pose:
        """Predict a frame that cannot be linked, or give the track up."""
        last = self._last
        ahead = self._expected(last, here.period)
        patient = here.period - last.period <= PATIENCE_FRAMES
        if not patient or hypot(*ahead) > self._max_displacement_px or not self._motion.known:
            return Pose(self._segment, nan, nan, Velocity(nan, nan), nan, nan, TrackingState.LOST)
        place = last.at + rect(1, last.angle) * complex(*ahead)
        angle = last.angle + self._expected_turn(last, here).angle
        velocity, predicted = self._motion.next_velocity, TrackingState.PREDICTED
        return Pose(self._segment, place.real, place.imag, velocity, nan, nan, predicted, angle)

    def _test_rotation(self, *, renew: bool) -> None:
        """Test, now and then, for rotation since the key frame, and from when on it is modelled."""
        key, last, link = self._key, self._last, self._newest
        if link is None or last is key or last.period - self._tested < _TEST_EVERY or not link.tells_turn:
            return
        self._tested = last.period
        found = self.registrar.remainder(key.view, last.view, link.warp, self._motion.spread_of_stretch)
        if found is None:
            return
        apart, turn = last.period - key.period, -float(found.step[-1])
        model = self._selection.weigh(found, keep=renew)
        covered, turned = self._covered + apart, self._turned + turn
        if model is not MotionModel.TRANSLATION:
            self._turning.rate = turned / covered
            last.angle = self._turning.rate * (last.period - self._began)
            key.angle = last.angle - turn
        elif renew:
            self._covered, self._turned = covered, turned

    def _expected(self, earlier: _Placed, period: int) -> Displacement:
        """Displacement from a placed frame that the motion so far suggests, in the orientation of the last one."""
        last = self._last
        ahead = self._motion.ahead(period - last.period)
        gone = rect(1, -last.angle) * (last.at - earlier.at)
        return Displacement(gone.real + ahead.row, gone.imag + ahead.col)

    def _prior(self, earlier: _Placed, here: _Placed, ahead: Displacement) -> MotionPrior:
        """Return the prior of the motion from a placed frame."""
        last = self._last
        before = None if earlier is last else (earlier.velocity, earlier.velocity_variance)
        share = MIN_SHARE if self.model is MotionModel.TRANSLATION else MIN_SHARE_TURNING
        return self._motion.prior(ahead, here.period - last.period, before, share)

    def _link(
        self, earlier: _Placed, here: _Placed, motion: MotionPrior, min_odds_nats: float = MIN_ODDS_NATS
    ) -> PairRegistration | None:
        """Register two frames, first at the expected shift, else over all; None if no shift is accepted."""
        turn = None if self.model is MotionModel.TRANSLATION else self._expected_turn(earlier, here)
        first = turn is None and not self._motion.known and self.registrar.registers_warps
        # correlation at half resolution that is needed: somewhat less than the usual one
        least = 0.0 if isnan(self._usual) else self._usual - self.registrar.fall_of_correlation
        for anywhere in (False, True) if self._motion.known and self.registrar.registers_warps else (True,):
            link = self.registrar.register(earlier.view, here.view, motion, least, anywhere=anywhere, turn=turn)
            if first and link is not None and link.at_half < least:  # unrelated, or turned: the rest costs more
                found = self.registrar.remainder(earlier.view, here.view, link.warp, motion.spread)
                if found is not None and found.may_turn:
                    link = self.registrar.register(earlier.view, here.view, motion, start=link.warp)
            if link is None or link.odds < min_odds_nats:
                continue
            link = (self._turned_much(earlier, here, link, motion) if first else None) or link
            if not link.at_half < least:
                return link
        return None

    def _turned_much(
        self, earlier: _Placed, here: _Placed, link: PairRegistration, motion: MotionPrior
    ) -> PairRegistration | None:
        """Return a first registration with rotation, if that is significant by itself: none may follow without it."""
        found = self.registrar.remainder(earlier.view, here.view, link.warp, motion.spread)
        if found is None or selected_model([found]) is MotionModel.TRANSLATION:
            return None
        for angle in (-float(found.step[-1]), -_LARGE_TURN, _LARGE_TURN):
            expected = Turn(angle, frames_apart=here.period - earlier.period)
            again = self.registrar.register(earlier.view, here.view, motion, anywhere=True, turn=expected)
            if again is not None and again.observed and again.tells_turn:
                if selected_model([found._replace(step=np.full(5, again.turn), sigma=again.turn_sigma)]):
                    self._selection.model, self._turning.rate = MotionModel.RIGID, again.turn / expected.frames_apart
                    return again
                break
        return None

    def _expected_turn(self, earlier: _Placed, here: _Placed) -> Turn:
        """Return the rotation between two frames that the turning so far suggests."""
        last, rate = self._last, self._turning.rate
        gap, apart = here.period - last.period, here.period - earlier.period
        return Turn(last.angle - earlier.angle + rate * gap, self._turning.spread(gap), apart)

    def _place(self, earlier: _Placed, here: _Placed, link: PairRegistration, motion: MotionPrior) -> bool:
        """Set a frame's pose, follow its motion; return False if the probe moved too unevenly within the frames."""
        shutter, expected = self.grid.shutter, motion.displacement
        moved = shutter.displacement(link.warp, link.velocity)
        gap = here.period - self._last.period
        # frames that came and were not linked tell of a jolt, lost ones do not
        lost = gap - (here.index - self._last.index)
        missed_px = hypot(moved.row - expected.row, moved.col - expected.col) / (1 + lost)
        jerk_sigma = self._motion.jerk_sigma(link.velocity, link.warp, missed_px)
        uneven_px = self._motion.unevenness * jerk_sigma
        if uneven_px > _UNEVEN_PX and self.registrar.registers_warps and self.model is MotionModel.TRANSLATION:
            evened = self.registrar.evened(earlier.view, here.view, motion, link, jerk_sigma)
            if evened is None:
                return False
            link, uneven_px = evened, self._motion.left_uneven_px(jerk_sigma, missed_px)
            moved = shutter.displacement(link.warp, link.velocity)
        here.velocity, here.velocity_variance = link.velocity, link.velocity_variance
        by_velocity = hypot(link.warp.b, link.warp.d) / shutter.line_periods_per_frame
        here.angle = earlier.angle + link.turn
        turned = here.angle - self._last.angle
        if self.model is not MotionModel.TRANSLATION:
            # a turn within a frame displaces its middle: where it sets in, that of one frame alone
            uneven_px += self._middle_px2 / shutter.line_periods_per_frame * abs(turned / gap - self._turning.rate)
        here.sigma = hypot(link.sigma, uneven_px, by_velocity * here.velocity_variance**0.5)
        if here.sigma > self.registrar.max_sigma_px:
            return False
        if not self._motion.known:
            earlier.velocity, earlier.velocity_variance = here.velocity, here.velocity_variance
        here.at = earlier.at + rect(1, here.angle) * complex(*moved)
        if self.model is not MotionModel.TRANSLATION:
            self._turning.follow(turned, gap, link.turn_sigma)
        self._motion.follow(here.velocity, here.velocity_variance, successive=gap == 1)
        self.links.append(TrackedPair(earlier.index, here.index, moved, link, here.period - earlier.period))
        return True

    def _track(self, here: _Placed, link: PairRegistration) -> Pose:
        self._last, self._newest = here, link
        fall = 0.0 if isnan(self._usual) else self._usual - link.at_half
        self._usual = link.at_half + (1 - _MEMORY) * fall
        row, col, tracked = here.at.real, here.at.imag, TrackingState.TRACKED
        return Pose(self._segment, row, col, here.velocity, link.correlation, here.sigma, tracked, here.angle)
