"""Rows per frame period, measured on a moving probe, for recordings whose calibration lacks it.

While the probe gains velocity, each frame is stretched a little more than the one before; the gain itself shows in the
shifts between frames. Their ratio is the rows per frame period, idle time included. Steady motion gives none.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from scipy.optimize import least_squares

from napari_elsplus.processing.analysis.uncertainty import robust_sigma
from napari_elsplus.processing.tracking.motion.rolling_shutter import RollingShutter, Warp

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.registration.pair_registration import TrackedPair

_ROUNDS: Final = 6
_TRUSTED: Final = 0.03
"""Largest uncertainty of the rows per frame, as a part of them, at which they are used."""
_FEWEST: Final = 10


class LinePeriodsPerFrame(NamedTuple):
    """Rows per frame period and one standard deviation of it, in rows of the grid."""

    rows: float
    sigma: float


def estimate_line_periods_per_frame(
    links: Sequence[TrackedPair], assumed: RollingShutter
) -> LinePeriodsPerFrame | None:
    """Estimate the rows per frame from the links of a track.

    Parameters
    ----------
    links : sequence of TrackedPair
        Only those between successive frames are used, and of these only runs of three.
    assumed : RollingShutter
        Timing with which the links were found; where to start.

    Returns
    -------
    LinePeriodsPerFrame or None
        None if the motion was too even, or too slow, to estimate it within 3 %.
    """
    # with little in view stretch and shear come from the prior, which assumes the timing that is to be estimated
    free = (link for link in links if link.later == link.earlier + 1 and link.periods == 1)
    warps = {link.earlier: link.registration.warp for link in free if link.registration.tells_turn}
    runs = [k for k in warps if k - 1 in warps and k + 1 in warps]
    if len(runs) < _FEWEST:
        return None

    def misfit(inverse: NDArray[np.float64]) -> NDArray[np.float64]:
        gained, bent = _gains(warps, runs, RollingShutter(1 / inverse.item()))
        return bent - inverse * gained

    inverse = np.array([1 / assumed.line_periods_per_frame])
    for _ in range(_ROUNDS):  # outliers are judged by the scatter about the last solution
        scale = float(robust_sigma(misfit(inverse))) + 1e-12
        inverse = least_squares(misfit, inverse, bounds=(0, np.inf), loss="cauchy", f_scale=3 * scale).x
    rows = 1 / inverse.item()
    gained, _ = _gains(warps, runs, RollingShutter(rows))
    sigma = rows**2 * scale / float(np.linalg.norm(gained))
    return LinePeriodsPerFrame(rows, sigma) if sigma < _TRUSTED * rows else None


def _gains(
    warps: dict[int, Warp], runs: Sequence[int], shutter: RollingShutter
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Velocity gained from frame to frame, rows then columns, and how much more bent the later frame is."""
    after = {k: shutter.velocities(warp)[1] for k, warp in warps.items()}
    step = {k: shutter.displacement(warp, after[k]) for k, warp in warps.items()}
    r = shutter.line_periods_per_frame
    rows = [((step[k + 1].row - step[k - 1].row) / 2, (1 - warps[k].a) * (1 + after[k].row / r)) for k in runs]
    cols = [((step[k + 1].col - step[k - 1].col) / 2, (1 - warps[k].a) * after[k].col / r - warps[k].s) for k in runs]
    both = np.array(rows + cols)
    return both[:, 0], both[:, 1]
