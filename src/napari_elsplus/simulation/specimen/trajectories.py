"""Trajectories of the probe: position over the scene against time, in micrometres (row, col)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np

from napari_elsplus.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Times = NDArray[np.float64]
    Positions = NDArray[np.float64]


class Trajectory(Protocol):
    """Path of the centre of the probe over the scene."""

    def positions_um(self, times_s: Times) -> Positions:
        """Return row and column, um, at each time, (n, 2)."""


@runtime_checkable
class TurningTrajectory(Trajectory, Protocol):
    """Path on which the probe also rotates about its centre."""

    def angles_rad(self, times_s: Times) -> Times:
        """Return the angle at each time, (n,), from rows towards columns."""


@dataclass(frozen=True, slots=True)
class Turning:
    """Path with a steady or a periodic rotation.

    Parameters
    ----------
    path : Trajectory
        Path of its centre.
    rate_deg_s : float
        Angular velocity at time 0.
    reach_deg : float
        Amplitude of a sinusoidal rotation; infinite for a steady one.

    Examples
    --------
    >>> turning = Turning(Still(), rate_deg_s=20.0)
    >>> np.rad2deg(turning.angles_rad(np.array([0.0, 0.5]))).round(6).tolist()
    [0.0, 10.0]
    """

    path: Trajectory
    rate_deg_s: float
    reach_deg: float = np.inf

    def positions_um(self, times_s: Times) -> Positions:
        """See :meth:`Trajectory.positions_um`."""
        return self.path.positions_um(times_s)

    def angles_rad(self, times_s: Times) -> Times:
        """Return the angle at each time, (n,)."""
        angle = np.deg2rad(self.rate_deg_s) * times_s
        if not np.isfinite(self.reach_deg):
            return np.asarray(angle, np.float64)
        reach = np.deg2rad(self.reach_deg)
        return np.asarray(reach * np.sin(angle / reach), np.float64)


@dataclass(frozen=True, slots=True)
class Still:
    """Probe at rest."""

    row_um: float = 0.0
    col_um: float = 0.0

    def positions_um(self, times_s: Times) -> Positions:
        """See :meth:`Trajectory.positions_um`."""
        return np.tile([self.row_um, self.col_um], (len(times_s), 1))


@dataclass(frozen=True, slots=True)
class Straight:
    """Straight line at constant speed; direction 0 is along columns, 90 degrees down the rows."""

    speed_um_s: float = 2000.0
    direction_deg: float = 30.0

    def positions_um(self, times_s: Times) -> Positions:
        """See :meth:`Trajectory.positions_um`."""
        angle = np.deg2rad(self.direction_deg)
        return np.outer(self.speed_um_s * times_s, [np.sin(angle), np.cos(angle)])


@dataclass(frozen=True, slots=True)
class Raster:
    """Raster with half circles between the lines, whose diameter is the pitch."""

    speed_um_s: float = 2000.0
    width_um: float = 1500.0
    pitch_um: float = 250.0

    def positions_um(self, times_s: Times) -> Positions:
        """See :meth:`Trajectory.positions_um`."""
        turn = np.pi * self.pitch_um / 2
        line, along = np.divmod(self.speed_um_s * times_s, self.width_um + turn)
        angle = np.clip(along - self.width_um, 0, None) / (self.pitch_um / 2)
        row = line * self.pitch_um + 0.5 * self.pitch_um * (1 - np.cos(angle))
        col = np.minimum(along, self.width_um) + 0.5 * self.pitch_um * np.sin(angle)
        return np.stack([row, np.where(line % 2 == 0, col, self.width_um - col)], axis=1)


@dataclass(frozen=True, slots=True)
class Spiral:
    """Archimedean spiral outwards at constant speed."""

    speed_um_s: float = 2000.0
    pitch_um: float = 200.0

    def positions_um(self, times_s: Times) -> Positions:
        """See :meth:`Trajectory.positions_um`."""
        per_radian = self.pitch_um / (2 * np.pi)
        path = self.speed_um_s * times_s / per_radian
        angle = np.sqrt(2 * np.abs(path))  # where the spiral's length is the path: Newton's steps from its far end
        for _ in range(5):
            root = np.sqrt(1 + angle**2)
            angle -= (0.5 * (angle * root + np.arcsinh(angle)) - path) / root
        radius = per_radian * angle
        return np.stack([radius * np.sin(angle), radius * np.cos(angle)], axis=1)


@dataclass(frozen=True, slots=True)
class Circle:
    """The probe moves along a circle, without end.

    Parameters
    ----------
    diameter_um : float
        Diameter.
    period_s : float
        Seconds for one round.
    """

    diameter_um: float = 500.0
    period_s: float = 1.0

    def positions_um(self, times_s: Times) -> Positions:
        """See :meth:`Trajectory.positions_um`; the circle begins at 0, 0."""
        angle = 2 * np.pi * times_s / self.period_s
        return np.stack([np.sin(angle), 1 - np.cos(angle)], axis=1) * (self.diameter_um / 2)

    def closed(self, rate_hz: float) -> Circle:
        """Return the circle whose round takes the nearest whole number of frames at a rate, so that they recur."""
        return replace(self, period_s=max(1, round(self.period_s * rate_hz)) / rate_hz)


@dataclass(frozen=True, slots=True)
class HandHeld:
    """Slow motion of a hand with physiological tremor (8 to 12 Hz).

    Parameters
    ----------
    speed_um_s : float
        Root-mean-square speed of the slow motion.
    tremor_um : float
        Root-mean-square amplitude of the tremor, each axis.
    seed : int
        Seed of the motion.
    """

    speed_um_s: float = 1500.0
    tremor_um: float = 15.0
    seed: int = 0

    def positions_um(self, times_s: Times) -> Positions:
        """See :meth:`Trajectory.positions_um`."""
        rng = np.random.default_rng(self.seed)
        wander_hz = rng.uniform(0.1, 0.7, (6, 2))
        tremor_hz = rng.uniform(8, 12, (4, 2))
        wander_phase, tremor_phase = rng.uniform(0, 2 * np.pi, (6, 2)), rng.uniform(0, 2 * np.pi, (4, 2))
        # each of n sines of amplitude A_i has rms speed 2 pi f_i A_i / sqrt 2; both axes share the speed
        wander = self.speed_um_s / (2 * np.pi * wander_hz * np.sqrt(6))
        tremor = self.tremor_um * np.sqrt(2 / 4)

        def at(times: Times) -> Positions:
            t = 2 * np.pi * times[:, None, None]
            slow = (wander * np.sin(t * wander_hz + wander_phase)).sum(1)
            fast = (tremor * np.sin(t * tremor_hz + tremor_phase)).sum(1)
            return np.asarray(slow + fast)

        return at(times_s) - at(np.zeros(1))


class Recorded:
    """Recorded path, interpolated linearly.

    Parameters
    ----------
    times_s : numpy.ndarray
        Increasing times.
    positions_um : numpy.ndarray
        (n, 2) row and column.

    Raises
    ------
    InputError
        If the times do not increase or a number is not finite.
    """

    def __init__(self, times_s: Times, positions_um: Positions) -> None:
        if len(times_s) < 2 or positions_um.shape != (len(times_s), 2):
            raise InputError(
                f"a recorded path of {len(times_s)} points", "give two or more, each with a row and a column"
            )
        if not (np.isfinite([times_s, *positions_um.T]).all() and (np.diff(times_s) > 0).all()):
            raise InputError("the recorded path has NaN or infinite numbers, or times that do not increase", "sort it")
        self._times_s, self._positions_um = times_s, positions_um

    def positions_um(self, times_s: Times) -> Positions:
        """Return row and column, um, at each time, (n, 2).

        Raises
        ------
        InputError
            If a time lies outside the recorded path.
        """
        first, last = self._times_s[0], self._times_s[-1]
        slack = 1e-9 + 1e-6 * (last - first)
        outside = times_s[(times_s < first - slack) | (times_s > last + slack)]
        if len(outside):
            raise InputError(
                f"the recorded path spans {first:.4g} to {last:.4g} s, a frame needs {outside[-1]:.4g} s",
                "take fewer frames",
            )
        return np.stack([np.interp(times_s, self._times_s, axis) for axis in self._positions_um.T], axis=1)


PATHS = ("still", "straight", "raster", "spiral", "hand")


def trajectory(name: str, *, speed_um_s: float = 2000.0, seed: int = 0) -> Trajectory:
    """Return the path of this name.

    Parameters
    ----------
    name : str
        One of `PATHS`.
    speed_um_s : float
        Speed; root-mean-square for ``hand``.
    seed : int
        Seed of ``hand``.

    Raises
    ------
    InputError
        If there is none, or the speed is not finite.
    """
    if not (np.isfinite(speed_um_s) and speed_um_s >= 0):
        raise InputError(f"the probe's speed is {speed_um_s} um/s", "it must be zero or more")
    paths: dict[str, Trajectory] = {
        "still": Still(),
        "straight": Straight(speed_um_s),
        "raster": Raster(speed_um_s),
        "spiral": Spiral(speed_um_s),
        "hand": HandHeld(speed_um_s, seed=seed),
    }
    if name not in paths:
        raise InputError(f"there is no path {name!r}", f"choose one of {', '.join(PATHS)} or a CSV file")
    return paths[name]
