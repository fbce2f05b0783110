"""Whether rotations between frames are those of a probe that turns, or of tissue that deforms.

A wave of displacement strains tissue by at least as much as it turns it, whatever its direction: its gradient has rank
one. A probe that turns strains nothing. Velocities, which follow from displacements, predict the stretch of the rows
and the shear of each warp; what they leave, added up along the track as the rotations are, is strain.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.processing.tracking.motion.pose import frame_periods

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from napari_elsplus.processing.tracking.motion.pose import Pose
    from napari_elsplus.processing.tracking.motion.rolling_shutter import RollingShutter
    from napari_elsplus.processing.tracking.registration.pair_registration import TrackedPair

MIN_TURN_OVER_STRAIN: Final = 2.0
"""Variance of the angle along a track over that of stretch and shear from which the probe turns. Derived: at most 1 for
one wave, if the stretch of columns were counted, too. Chosen: of 300 tracks over random sums of one, two, or four waves
5, 3 and 1 % have more; probes that turned by 1 to 10 degrees had 18 and more, two of five over deforming tissue."""


def probe_turns(
    poses: Sequence[Pose], links: Sequence[TrackedPair], shutter: RollingShutter, lost: Mapping[int, int]
) -> bool:
    """Return True if the probe turns, False if tissue that deforms explains the rotations of registrations.

    Parameters
    ----------
    poses : sequence of Pose
        One for every frame.
    links : sequence of TrackedPair
        The registrations that locate them, with rotation, in their order.
    shutter : RollingShutter
        Timing of the rows.
    lost : mapping of int to int
        How many frames were lost before some, by their index.
    """
    times = frame_periods(len(poses), lost)
    at, turn = np.array([pose.at for pose in poses]), np.exp(-1j * np.array([pose.angle for pose in poses]))
    segments, velocity = np.array([pose.segment for pose in poses]), np.full(len(poses), np.nan + 0j)
    runs = [np.flatnonzero((segments == segment) & np.isfinite(at)) for segment in np.unique(segments)]
    for run in runs:
        if len(run) > 1:
            velocity[run] = np.gradient(at[run], times[run]) * turn[run]
    rows = shutter.line_periods_per_frame
    total = np.zeros((len(poses), 3))
    for earlier, later, _, link, periods in links:
        before, after = velocity[earlier], velocity[later]
        gained, (a, b, s, _) = (after - before) / periods, link.warp
        stretch = a - (1 + before.real / rows) / (1 + after.real / rows) + gained.real * b / rows**2
        shear = s - (before.imag - a * after.imag) / rows + gained.imag * b / rows**2
        total[later] = total[earlier] + np.nan_to_num((link.turn, stretch, shear))
    turned, *strained = sum(total[run].var(axis=0) * len(run) for run in runs if len(run))
    return bool(turned > MIN_TURN_OVER_STRAIN * sum(strained))
