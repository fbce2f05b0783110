"""Motion of the probe as estimated so far, and the prior that it gives the next registration.

A hand keeps its velocity, and for a moment some of its acceleration; how far the next velocity may be from that is
learnt from how far the last ones were.
"""

from __future__ import annotations

from math import hypot, pi, sqrt
from typing import TYPE_CHECKING, Final

from napari_elsplus.processing.tracking.motion.motion_prior import MotionPrior, terms_of
from napari_elsplus.processing.tracking.motion.rolling_shutter import Displacement, Velocity

if TYPE_CHECKING:
    from napari_elsplus.processing.tracking.motion.motion_prior import Covariance
    from napari_elsplus.processing.tracking.motion.rolling_shutter import RollingShutter, Warp

AT_REST: Final = Velocity(0.0, 0.0)
_JOLT: Final = 1 / 24
"""Mean over a frame of the parabola that a unit acceleration makes, per squared time in which the frame is read."""
_JERK_VARIANCE: Final = 20 / 7
"""Variance of the difference of two frames' accelerations over that of the velocity after a frame period, times the
part of it in which a frame is read; derived for white-noise acceleration and least squares."""
_UNEVEN: Final = 7 / 3200
_UNEVEN_ESTIMATED: Final = 7 / 47440
"""Variance of the middle of a frame from that of the difference of the accelerations, per fourth power of that part,
where even motion is fitted within each frame; and where the difference is estimated, too. Derived likewise."""
LEFT_UNEVEN: Final = _UNEVEN_ESTIMATED / _UNEVEN
"""Part of that variance which the estimate leaves."""
_MIN_SPREAD: Final = 0.3
"""Smallest standard deviation of the next velocity, pixels per frame period; chosen, about a hand's tremor."""
_MEMORY: Final = 0.3
FIRST_SPEED: Final = 0.3
"""Standard deviation of an unknown velocity, diameters per frame period; chosen, half of the fastest tracked."""
_FIRST_SURPRISE: Final = 1.2
"""Mean distance of velocities from those expected, before any was observed, pixels per frame period and frame period
over the time in which a frame is read: the longer the period, the more a hand changes its velocity; chosen on 14
recordings a row of ``benchmarks.studies.acceptance``."""
_UNKNOWN_READ: Final = 0.3
"""Part of the frame period in which a frame is read, where the timing is unknown; chosen, that of some 80 Hz."""
_SPREAD_OF_SURPRISE: Final = 2 / pi
"""Scale of a velocity, in each axis, over the mean distance of recent ones from those expected; derived for Student's
t-distribution in two dimensions with the prior's four degrees of freedom (in one, for rotation, it is 1)."""
MIN_SHARE: Final = 2.0
MIN_SHARE_TURNING: Final = 0.3
"""Smallest variance of an estimated velocity over that of the next one; chosen. Distortion of the optics adds the same
to the stretch of every frame: were velocities trusted more than displacements, such errors would add up. Where the
probe turns, shear may be rotation as well as velocity, which is therefore held more firmly."""
_FIRST_TURN: Final = 0.004
_LEAST_TURN: Final = 0.0005
"""Radians per frame by which a turn may well differ from what is expected: before any was seen, and at least."""
_KEPT: Final = 0.5
"""Part of the last change of velocity that is expected to go on."""


class Motion:
    """Velocity and acceleration of the probe from the accepted registrations.

    Parameters
    ----------
    shutter : RollingShutter
        Timing of the rows.
    diameter : float
        Diameter of the field in pixels.
    surprise : float, optional
        Mean distance of velocities from those expected, where it was learnt before the track was lost.

    Attributes
    ----------
    known : bool
        True if any registration was accepted yet.
    velocity, next_velocity : Velocity
        During the last frame that was registered, and expected in those to come; pixels per frame period.
    variance : float
        Of that velocity.
    surprise : float
        Mean distance of recent velocities from those expected.
    unevenness : float
        Standard deviation of a displacement, pixels, over that of the change of acceleration (:meth:`jerk_sigma`): the
        rolling shutter's warp is exact for even motion within each frame, and under a steady acceleration.

    Examples
    --------
    >>> from napari_elsplus.processing.tracking.motion.rolling_shutter import RollingShutter
    >>> motion = Motion(RollingShutter(300.0), 200.0)
    >>> motion.follow(Velocity(20.0, 0.0), 0.01, successive=True)
    >>> motion.follow(Velocity(22.0, 0.0), 0.01, successive=True)
    >>> motion.ahead(1)
    Displacement(row=22.5, col=0.0)
    """

    def __init__(self, shutter: RollingShutter, diameter: float, surprise: float | None = None) -> None:
        self._shutter, self._diameter = shutter, diameter
        self._read = min(diameter / shutter.line_periods_per_frame, 1.0)
        self._jerk = sqrt(_JERK_VARIANCE / self._read) if self._read else 0.0
        self.unevenness = sqrt(_UNEVEN) * self._read**2
        self.known = False
        self.velocity = self.next_velocity = AT_REST
        self.variance = (FIRST_SPEED * diameter) ** 2
        self.surprise = _FIRST_SURPRISE / (self._read or _UNKNOWN_READ) if surprise is None else surprise

    def forgotten(self) -> Motion:
        """Return the motion of a probe of which only is known how unpredictable it has been so far."""
        return Motion(self._shutter, self._diameter, self.surprise)

    def follow(self, velocity: Velocity, variance: float, *, successive: bool) -> None:
        """Add the velocity of a registered frame.

        Parameters
        ----------
        velocity : Velocity
            Pixels per frame period.
        variance : float
            Of the velocity.
        successive : bool
            True if the frame just before it was registered as well.
        """
        following = velocity
        if self.known and successive:
            before, expected = self.velocity, self.next_velocity
            miss = hypot(velocity.row - expected.row, velocity.col - expected.col)
            self.surprise += _MEMORY * (miss - self.surprise)
            gained = velocity.row - before.row, velocity.col - before.col
            following = Velocity(velocity.row + _KEPT * gained[0], velocity.col + _KEPT * gained[1])
        self.velocity, self.next_velocity, self.known = velocity, following, True
        self.variance = variance

    def jerk_sigma(self, velocity: Velocity, warp: Warp, missed_px: float) -> float:
        """Return the standard deviation by which the acceleration changes between two frames, px per squared period.

        Each axis; from the spread of the velocity, or from what these frames were surprising by, if that is more.

        Parameters
        ----------
        velocity : Velocity
            Of the later frame, pixels per frame period.
        warp : Warp
            From the earlier to the later frame.
        missed_px : float
            Distance of the displacement from the expected one, over one more than the frames that were lost meanwhile:
            a jolt between two frames lies in part within them.
        """
        if not self._read:
            return 0.0
        if self.known:
            expected = self.next_velocity
            change = max(hypot(velocity.row - expected.row, velocity.col - expected.col), missed_px)
        else:
            change = self._shutter.line_periods_per_frame * hypot(warp.a - 1, warp.s)
        return self._jerk * max(_SPREAD_OF_SURPRISE * change, self.spread)

    def left_uneven_px(self, jerk_sigma: float, missed_px: float) -> float:
        """Return what :attr:`unevenness` leaves where the change of acceleration is estimated from the frames, pixels.

        A jolt is more than that: after it neither the velocity nor the acceleration is known.

        Parameters
        ----------
        jerk_sigma, missed_px
            As of :meth:`jerk_sigma`.
        """
        jolt_px = _JOLT * missed_px if self.known else 0.0
        return self._read**2 * hypot(sqrt(_UNEVEN_ESTIMATED) * jerk_sigma, jolt_px)

    @property
    def spread(self) -> float:
        """Standard deviation of the next velocity about what is expected."""
        return _MIN_SPREAD + _SPREAD_OF_SURPRISE * self.surprise

    @property
    def spread_of_stretch(self) -> float:
        """Standard deviation of stretch, and of shear, between successive frames, given the shift."""
        covariance = _of_random_walk(self.variance, self.spread**2, 1, None)
        return float(terms_of(covariance, self._shutter.line_periods_per_frame)[0] ** -0.5)

    def ahead(self, frames: int) -> Displacement:
        """Displacement expected from the last registered frame to one so many frames later."""
        now, later = self.velocity, self.next_velocity
        # up to the next frame the mean of both velocities, and from there on the later one
        return Displacement(0.5 * now.row + (frames - 0.5) * later.row, 0.5 * now.col + (frames - 0.5) * later.col)

    def prior(
        self, displacement: Displacement, frames: int, before: tuple[Velocity, float] | None = None,
        min_share: float = MIN_SHARE,
    ) -> MotionPrior:  # fmt: skip
        """Return the prior of the motion from an earlier frame to one so many frames after the last registered one.

        Parameters
        ----------
        displacement : Displacement
            Expected from the earlier frame.
        frames : int
            Frame periods since the last registered frame.
        before : tuple, optional
            Velocity of the earlier frame and its variance, if that is another than the last registered one.
        min_share : float
            Smallest variance of the last velocity over that of the next one by which velocities are estimated.
        """
        q = self.spread**2
        velocity, variance = (self.velocity, None) if before is None else before
        covariance = _of_random_walk(self.variance, q, frames, variance)
        cautious = _of_random_walk(max(self.variance, min_share * q), q, frames, variance)
        rows = self._shutter.line_periods_per_frame
        return MotionPrior(velocity, self.next_velocity, displacement, covariance, cautious, rows)


def _of_random_walk(last: float, q: float, frames: int, earlier: float | None) -> Covariance:
    """Return the covariance of earlier velocity, displacement and later velocity (3 x 3).

    Parameters
    ----------
    last : float
        Variance of the last velocity.
    q : float
        Variance that a velocity gains in a frame period.
    frames : int
        Frame periods since the last velocity.
    earlier : float or None
        Variance of the earlier velocity, if that is another one than the last.
    """
    shift = last * frames**2 + q * frames**3 / 3
    both = last * frames + q * frames**2 / 2
    variance, with_shift, with_later = (last, last * frames, last) if earlier is None else (earlier, 0.0, 0.0)
    return (variance, with_shift, with_later), (with_shift, shift, both), (with_later, both, last + q * frames)


class Turning:
    """Rate of rotation of the probe from accepted registrations, and its scatter.

    Parameters
    ----------
    rate : float
        Radians per frame.
    surprise : float
        Mean distance of rates from those expected, where it was learnt before the track was lost, radians per frame; at
        least what it is before any rotation was seen.

    Attributes
    ----------
    rate, surprise : float
        Those so far.

    Examples
    --------
    >>> turning = Turning()
    >>> for _ in range(20):
    ...     turning.follow(0.002, 1, 0.0002)
    >>> round(turning.rate, 4), turning.spread(1) < 0.001
    (0.002, True)
    """

    def __init__(self, rate: float = 0.0, surprise: float = 0.0) -> None:
        self.rate = rate
        self.surprise = max(surprise, _FIRST_TURN)

    def follow(self, turned: float, frames: int, sigma: float) -> None:
        """Add a rotation; the rate follows it the more, the more of the recent surprise is not uncertainty.

        Parameters
        ----------
        turned : float
            Radians.
        frames : int
            Frame periods within which the probe rotated.
        sigma : float
            Standard deviation of the rotation, radians.
        """
        miss = turned / frames - self.rate
        self.surprise += _MEMORY * (abs(miss) - self.surprise)
        uncertain = (sigma / frames) ** 2 / (pi / 2 * self.surprise**2 + _LEAST_TURN**2)
        self.rate += max(_MEMORY, 1 - uncertain) * miss

    def spread(self, frames: int) -> float:
        """Return the standard deviation of the turn within so many frames about what is expected."""
        return frames * (_LEAST_TURN + self.surprise)
