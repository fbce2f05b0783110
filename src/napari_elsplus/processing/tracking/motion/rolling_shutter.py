"""Motion within a frame: what a rolling shutter does to a pair of frames, and how to undo it.

Each row is read at its own time, so a moving probe stretches and shears every frame, and the shift between two frames
is not the displacement of the probe. While the probe moves evenly within each frame, the warp from one frame to
another is exactly affine with four parameters, and these four are the two velocities.

Coordinates are rows and columns about the centre of the bundle. A frame that moves with velocity (v, w) pixels per
frame period shows at (y, x) the point (y + v y / R, x + w y / R) of the scene, relative to the probe's position at the
time at which the bundle's middle row is read; R is the number of rows per frame period, idle time included.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from typing import NamedTuple

from napari_elsplus.errors import InputError
from napari_elsplus.processing.compiled import compilable


class Velocity(NamedTuple):
    """Velocity of the probe while one frame is read, in pixels per frame period."""

    row: float
    col: float


class Warp(NamedTuple):
    """Map of a frame's pixels into another: ``y' = a y + b``, ``x' = x + s y + d``, about the bundle's centre."""

    a: float = 1.0
    b: float = 0.0
    s: float = 0.0
    d: float = 0.0


class Displacement(NamedTuple):
    """Displacement of the probe from the middle row of one frame to that of another, in pixels."""

    row: float
    col: float


@compilable
def warp_between(before: Velocity, after: Velocity, displacement: Displacement, line_periods_per_frame: float) -> Warp:
    """Return the warp from one frame to another: :meth:`RollingShutter.warp`."""
    stretch = 1 + after.row / line_periods_per_frame
    a = (1 + before.row / line_periods_per_frame) / stretch
    b = -displacement.row / stretch
    shear = (before.col - a * after.col) / line_periods_per_frame
    return Warp(a, b, shear, -displacement.col - after.col / line_periods_per_frame * b)


@dataclass(frozen=True, slots=True)
class RollingShutter:
    """The timing of the rows on one grid of pixels.

    Parameters
    ----------
    line_periods_per_frame : float
        Rows of the grid per frame period, idle time included. Infinite for a global shutter, or without
        calibration: the warp between two frames is then a translation.

    Examples
    --------
    A steady motion of (30, 12) pixels per frame is measured as a smaller shift; the correction gives it back.

    >>> shutter = RollingShutter(300.0)
    >>> steady = Velocity(30.0, 12.0)
    >>> warp = shutter.warp(steady, steady, shutter.step(steady, steady))
    >>> round(warp.b, 2), round(warp.d, 2)
    (-27.27, -10.91)
    >>> before, after = shutter.velocities(warp)
    >>> round(after.row, 6), round(after.col, 6)
    (30.0, 12.0)
    """

    line_periods_per_frame: float

    def __post_init__(self) -> None:
        if not self.line_periods_per_frame > 0:
            raise InputError(f"line_periods_per_frame is {self.line_periods_per_frame}", "it must be positive")

    def step(self, before: Velocity, after: Velocity) -> Displacement:
        """Displacement between the middle rows of successive frames: the mean of their velocities.

        Each velocity is that at the middle row, so this holds for every steady acceleration, at any frame rate.

        Parameters
        ----------
        before, after : Velocity
            Of the earlier and of the later frame, pixels per frame period.
        """
        return Displacement((before.row + after.row) / 2, (before.col + after.col) / 2)

    def warp(self, before: Velocity, after: Velocity, displacement: Displacement) -> Warp:
        """Warp from one frame to another that are any number of frames apart.

        Parameters
        ----------
        before, after : Velocity
            Of the earlier and of the later frame, pixels per frame period.
        displacement : Displacement
            Between their middle rows.
        """
        return warp_between(before, after, displacement, self.line_periods_per_frame)

    def velocities(self, warp: Warp, periods: int = 1) -> tuple[Velocity, Velocity]:
        """Velocities of both of two frames, from the warp between them alone.

        The four parameters are just enough, because the displacement is the mean of the velocities, times the time.

        Parameters
        ----------
        warp : Warp
            From the earlier to the later frame.
        periods : int
            Frame periods between them: 1 for successive frames.
        """
        r, b, d = self.line_periods_per_frame, warp.b / periods, warp.d / periods
        if not isfinite(r):
            return (steady := Velocity(-b, -d)), steady
        stretch = 1 / ((warp.a + 1) / 2 + b / r)
        col = -stretch * (d + warp.s * r / 2)
        return (
            Velocity(r * (warp.a * stretch - 1), warp.s * r + warp.a * col),
            Velocity(r * (stretch - 1), col),
        )

    def displacement(self, warp: Warp, after: Velocity) -> Displacement:
        """Displacement of the probe over any number of frames, from the warp and the later frame's velocity.

        Parameters
        ----------
        warp : Warp
            From the earlier to the later frame.
        after : Velocity
            Of the later frame.
        """
        r = self.line_periods_per_frame
        return Displacement(-warp.b * (1 + after.row / r), -warp.d - after.col / r * warp.b)
