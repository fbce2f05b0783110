"""Registration of two frames: the warp between them, its covariance, and its log posterior odds.

From the expected warp, or else from the best peak of a masked correlation over all shifts, down a pyramid of
Lucas-Kanade steps to full resolution; then against competing shifts.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot, inf, nan
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from napari_elsplus.processing.compiled import resolved_once
from napari_elsplus.processing.tracking.front_end.sampling import FramePair
from napari_elsplus.processing.tracking.motion.rolling_shutter import Displacement, Velocity, Warp
from napari_elsplus.processing.tracking.registration import motion_models
from napari_elsplus.processing.tracking.registration.odds import log_odds_between, weakest_direction
from napari_elsplus.processing.tracking.registration.pyramid import Levels, fill_levels
from napari_elsplus.processing.tracking.registration.pyramid_descent import Tools, later_velocity, register
from napari_elsplus.processing.tracking.registration.shift_search import MAX_PEAKS, EveryShift
from napari_elsplus.processing.tracking.registration.uneven_motion import EXACT_PX, align_unevenly

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.front_end.grid import Grid
    from napari_elsplus.processing.tracking.motion.motion_prior import MotionPrior

MIN_ODDS_NATS: Final = 10.0
"""Log posterior odds from which a registration is accepted; chosen on 14 recordings a row of
``benchmarks.studies.acceptance`` (seeds 0 to 7 and 100 to 105) that are not those reported: in sparse and jerky scenes
7 of 5,912 are wrong."""
MAX_SIGMA_PX: Final = 0.6
"""Standard deviation of a displacement, pixels, up to which it is used: below a core pitch; chosen: at 0.7 of 3,662
registrations of jerky motion 11 are wrong, at 0.5 a tenth fewer are kept."""
FALL_OF_CORRELATION: Final = 0.06
"""Correlation at half resolution below the recent mean from which a registration is rejected: frames that show the same
differ by noise, which is the same for all; chosen: with 0.08 one more jolted one of 1,406 is wrong, with 0.05 hazy
frames are lost."""
TURNING_FIELD: Final = 0.85
"""Part of the diameter in which a rotation is estimated; chosen: what does not move at the rim biases it by 0.01
degrees a frame with the whole field of 0.9 (independent rig, vessels); with 0.8 there is less to compare."""
_AT_REST: Final = Velocity(0.0, 0.0)
_register, _score_rotation = resolved_once(register), resolved_once(motion_models.score_rotation)
_weakest_direction = resolved_once(weakest_direction)
_TELLING_PX: Final = 0.1
_TURNS: Final = 4
_APART_PX: Final = 2.0
"""Distance from which two registrations are two shifts; chosen: half that of the nearest competitor of the odds."""
_SMALL_TURN: Final = 0.004
"""Angle, in radians, up to which one linear step is exact enough: half a pixel at the rim."""


@dataclass(slots=True)
class PreparedFrame:
    """A tracking image with its pyramid, and, once needed, what a search over all shifts needs of it.

    The arrays belong to the frame and are filled again and again, by :meth:`Registrar.prepare` or when first needed.
    """

    arrays: Levels
    coarse: Any = None

    @property
    def image(self) -> NDArray[np.float32]:
        """The image at full resolution."""
        return self.arrays.images[0]

    @property
    def levels(self) -> tuple[NDArray[np.float32], ...]:
        """The image, its high-passed halves and quarters, and the image high-passed."""
        return self.arrays.images

    def renew(self) -> None:
        """Mark everything but the image as missing: the image has changed."""
        self.coarse = None
        self.arrays.filled.fill(False)


class PairRegistration(NamedTuple):
    """Registration of a frame on an earlier one.

    Parameters
    ----------
    warp : Warp
        From the earlier frame's pixels to the later one's.
    information : numpy.ndarray
        (4, 4) inverse covariance of a, b, s, d.
    correlation : float
        Zero-mean normalised correlation of the overlap.
    overlap : float
        Part of the disc that both frames show.
    odds : float
        Log posterior odds against competing shifts, or against unrelated frames where the shift is sharp; nats.
    velocity : Velocity
        Of the probe during the later frame, pixels per frame period.
    velocity_variance : float
        Larger axis of its covariance.
    turn : float
        Angle of the later frame less that of the earlier one, radians.
    turn_sigma : float
        One standard deviation of the angle; infinite where no rotation was modelled.
    at_half : float
        Correlation at half resolution, where all frames are high-passed; at full resolution only some are.
    evened : bool
        True if uneven motion within the frames was estimated.
    """

    warp: Warp
    information: NDArray[np.float64]
    correlation: float
    overlap: float
    odds: float = 0.0
    velocity: Velocity = Velocity(nan, nan)
    velocity_variance: float = inf
    turn: float = 0.0
    turn_sigma: float = inf
    at_half: float = nan
    evened: bool = False

    @property
    def observed(self) -> bool:
        """Return True if the shift is accepted."""
        return self.odds >= MIN_ODDS_NATS

    @property
    def sigma(self) -> float:
        """Larger axis of the shift's uncertainty, one standard deviation in pixels."""
        return float(_weakest_direction(self.information)[0])

    @property
    def tells_turn(self) -> bool:
        """Return True if rotation is distinguishable from stretch: with one or two fibres in view it is not."""
        return self.sigma < _TELLING_PX

    @property
    def covariance(self) -> NDArray[np.float64]:
        """(2, 2) covariance of the shift (rows, cols), px squared; NaN where nothing constrains it."""
        try:
            return np.ascontiguousarray(np.linalg.inv(self.information)[1::2, 1::2])
        except np.linalg.LinAlgError:
            return np.full((2, 2), nan)


class TrackedPair(NamedTuple):
    """A registration that the tracker has accepted.

    Parameters
    ----------
    earlier, later : int
        The two frames, by the tracker's count.
    displacement : Displacement
        Of the later frame from the earlier one, in the later one's orientation, pixels.
    registration : PairRegistration
        Of the two.
    periods : int
        Frame periods between them, those of lost frames included.
    """

    earlier: int
    later: int
    displacement: Displacement
    registration: PairRegistration
    periods: int = 1


class Turn(NamedTuple):
    """Rotation of a probe between two frames, as expected.

    Parameters
    ----------
    angle : float
        Angle of the later frame less that of the earlier one, radians.
    sigma : float
        Its standard deviation, radians. In a view with one fibre rotation and shift cannot be distinguished.
    frames_apart : float
        Frame periods within which the probe turns, evenly; infinite where its rate in each frame is unknown.
    """

    angle: float
    sigma: float = inf
    frames_apart: float = inf


class Registrar:
    """Registers frames on one grid; keeps what depends on the grid alone. Not for two threads at once.

    Parameters
    ----------
    grid : Grid
        The grid of the tracking images.
    lit : float
        Part of the diameter within which images are lit, all of it by default: dark pixels beyond would leave a static
        rim in high-passed images.

    Attributes
    ----------
    max_sigma_px : float
        Standard deviation of a displacement up to which the tracker uses registrations.
    fall_of_correlation : float
        Correlation below the recent mean from which it does not.
    rigid_correlation : float
        Recent mean of the correlation below which each frame is registered to the one before, not to a keyframe.
    registers_warps : bool
        True if the whole warp is registered, from the expected one where possible, with rotation and uneven motion
        within the frames; False if the shift alone is, anywhere.
    """

    max_sigma_px, fall_of_correlation, rigid_correlation, registers_warps = MAX_SIGMA_PX, FALL_OF_CORRELATION, 0.0, True

    def __init__(self, grid: Grid, lit: float = 1.0) -> None:
        self.grid = grid
        half = grid.binned(2)
        self._turning, self._column = half.spans(TURNING_FIELD), half.centre[1]
        self._everywhere = EveryShift(grid)
        self._tools = Tools.of(grid, lit)
        self._scratch = self.view()

    def view(self) -> PreparedFrame:
        """Return an empty view, to be filled again and again."""
        return PreparedFrame(Levels.of(self.grid.side))

    def prepare(self, view: PreparedFrame) -> PreparedFrame:
        """Fill the high-passed coarser levels from the image.

        Parameters
        ----------
        view : PreparedFrame
            Of which the image was filled.
        """
        view.renew()
        fill_levels(view.arrays, self._tools.pyramid)
        return view

    def register(
        self, earlier: PreparedFrame, later: PreparedFrame, motion: MotionPrior, min_correlation: float = 0.0,
        *, anywhere: bool = False, turn: Turn | None = None, start: Warp | None = None,
    ) -> PairRegistration | None:  # fmt: skip
        """Register two frames; None where nothing was found.

        Parameters
        ----------
        earlier, later : PreparedFrame
            Prepared frames.
        motion : MotionPrior
            Prior of the motion between them; if they may be rotated, in the later frame's orientation, with the earlier
            frame's velocity in its own.
        min_correlation : float
            Correlation at half resolution that is needed: without it the odds are minus infinity. Not used for frames
            that may be rotated.
        anywhere : bool
            True to start from the best of all shifts, False to start from the expected warp.
        turn : Turn, optional
            Rotation that is expected, if the later frame may be rotated against the earlier one; none by default.
        start : Warp, optional
            Where to start instead of the expected warp.
        """
        if turn is not None:
            return self._turned(earlier, later, motion, turn, anywhere=anywhere)
        if anywhere:
            return self._likeliest(earlier, later, motion, min_correlation)
        return self._refined(earlier, later, motion, start, min_correlation)

    def _refined(
        self, earlier: PreparedFrame, later: PreparedFrame, motion: MotionPrior, start: Warp | None = None,
        min_correlation: float = 0.0,
    ) -> PairRegistration:  # fmt: skip
        """Register two frames from a warp, or from the expected one."""
        information, tools = np.empty((4, 4)), self._tools
        a, b, s, d, correlation, overlap, odds, row, col, variance, at_half = _register(
            earlier.arrays, later.arrays, motion, start or Warp(), start is None, min_correlation, tools, information
        )
        warp, velocity = Warp(a, b, s, d), Velocity(row, col)
        return PairRegistration(warp, information, correlation, overlap, odds, velocity, variance, at_half=at_half)

    def _likeliest(
        self, earlier: PreparedFrame, later: PreparedFrame, motion: MotionPrior, min_correlation: float
    ) -> PairRegistration:
        """Register two frames from every shift that may be the most likely one; the odds know of the others."""
        halves, known = self._halves(earlier, later), (motion.warp, motion.terms, self._tools.blocks)
        starts = self._searched(earlier, later, motion)
        links = [self._refined(earlier, later, motion, start, min_correlation) for start in starts]
        found = [link for link in links if link.correlation > 0] or links[:1]
        best = found[0]
        for link in found[1:]:
            if log_odds_between(halves, link.warp, best.warp, *known) > 0:
                best = link
        others = (
            log_odds_between(halves, best.warp, link.warp, *known)
            for link in found
            if hypot(link.warp.b - best.warp.b, link.warp.d - best.warp.d) > _APART_PX
        )
        return best._replace(odds=min([best.odds, 0.0 if len(starts) > 2 * MAX_PEAKS else inf, *others]))

    def _searched(self, earlier: PreparedFrame, later: PreparedFrame, motion: MotionPrior) -> list[Warp]:
        """Return the expected warp at the most likely of all shifts, and at those that may be as likely."""
        for view in (earlier, later):
            fill_levels(view.arrays, self._tools.pyramid)
            if view.coarse is None:
                view.coarse = self._everywhere.of_frame(view.levels)
        return self._everywhere.starts(earlier.coarse, later.coarse, (earlier.levels, later.levels), motion)

    def remainder(
        self, earlier: PreparedFrame, later: PreparedFrame, warp: Warp, spread: float,
        turn: tuple[float, float] = (0.0, inf), *, rim: bool = True,
    ) -> motion_models.Remainder | None:  # fmt: skip
        """Estimate what a rotation would add to a warp; None where the frames constrain nothing.

        Parameters
        ----------
        earlier, later : PreparedFrame
            Prepared frames.
        warp : Warp
            Registered warp.
        spread : float
            Standard deviation of stretch and shear about those of the warp.
        turn : tuple of float
            Rotation that is expected, radians, and its standard deviation.
        rim : bool
            Compare the rim as well: a test has more power with it, an estimate less bias without.
        """
        pair = self._halves(earlier, later, rim=rim)
        *step, sigma, values, control = _score_rotation(pair, self._column, warp, spread**-2, turn, self._tools.work)
        return motion_models.Remainder(np.array(step), sigma, values, control) if values else None

    def _turned(
        self, earlier: PreparedFrame, later: PreparedFrame, motion: MotionPrior, expected: Turn, *, anywhere: bool
    ) -> PairRegistration | None:
        """Register two frames one of which may be rotated; the warp is the one that upright frames would have had."""
        own, before, rows = motion, motion.before, motion.line_periods_per_frame
        motion, scratch = motion._replace(before=_AT_REST), self._scratch
        turn, sigma = expected.angle, inf
        warp, start, searches = motion.warp, None, anywhere
        unsheared = motion_models.unsheared(before, rows)
        for _ in range(_TURNS):
            rate = turn / expected.frames_apart / rows
            while_read = motion_models.turned_while_read(rate, warp, turn, self._tools.diameter)
            matrix = motion_models.turned_by(-turn) @ unsheared + while_read[:, :2]
            motion_models.upright(earlier.image, scratch.image, self.grid.centre, matrix, while_read[:, 2])
            upright = self.prepare(scratch)
            if searches:
                link = self._likeliest(upright, later, motion, 0.0)
            else:
                link = self._refined(upright, later, motion, start)
            searches = anywhere and not link.observed
            left = turn - expected.angle, expected.sigma
            found = self.remainder(upright, later, link.warp, motion.spread, left, rim=False)
            if found is None:
                return None
            warp, more = motion_models.composed(link.warp, found.step)
            start = warp
            turn, sigma = turn - more, found.sigma
            if abs(more) < _SMALL_TURN:
                break
        stretch, shear = 1 + before.row / rows, before.col / rows
        warp = Warp(warp.a * stretch, warp.b, warp.s * stretch + shear, warp.d)
        return self.followed(link._replace(warp=warp, turn=turn, turn_sigma=sigma), own)

    def evened(
        self, earlier: PreparedFrame, later: PreparedFrame, motion: MotionPrior, link: PairRegistration,
        jerk_sigma: float,
    ) -> PairRegistration | None:  # fmt: skip
        """Return the registration of the middle rows of frames that moved unevenly; None where it is unconstrained.

        Parameters
        ----------
        earlier, later, motion
            As of :meth:`register`.
        link : PairRegistration
            Of even motion within each frame.
        jerk_sigma : float
            Standard deviation of the change of the acceleration between the frames, pixels per squared frame period.
        """
        found = align_unevenly(self._halves(earlier, later), motion, link.warp, jerk_sigma)
        if found is None:
            return None
        warp, link = found[0], link._replace(information=found[1], evened=True)
        if hypot(warp.b - link.warp.b, warp.d - link.warp.d) < EXACT_PX:
            return link
        return self.followed(link._replace(warp=warp), motion)

    def followed(self, link: PairRegistration, motion: MotionPrior) -> PairRegistration:
        """Return a registration with the later frame's velocity as it follows from the warp.

        Parameters
        ----------
        link : PairRegistration
            Of two frames.
        motion : MotionPrior
            Prior of the motion between them.
        """
        row, col, variance = later_velocity(motion, link.warp, link.information, self._tools.work)
        return link._replace(velocity=Velocity(row, col), velocity_variance=variance)

    def _halves(self, earlier: PreparedFrame, later: PreparedFrame, *, rim: bool = True) -> FramePair:
        """Return two frames at half resolution, with or without the rim."""
        first, last = self._tools.lit[1] if rim else self._turning
        return FramePair(earlier.levels[1], later.levels[1], first, last, self._tools.middles[1])
