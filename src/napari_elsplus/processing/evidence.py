"""Whether another shift would explain two frames as well: the gate of the tracker.

Along a straight fibre, in an empty view or under a lifted probe a correlation can be high and its shift wrong. So a
link is compared with its rivals: warps that are held a few pixels away, along the direction in which the shift is
known least, and otherwise fitted to the frames as well as they can be. What counts is how much worse the best of them
is.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.compiled import kernel
from napari_elsplus.processing.lucas_kanade import align, correlation

if TYPE_CHECKING:
    from numpy.typing import NDArray

RIVAL_PX: Final = 4.0
"""Distance of the nearest rivals of a shift."""
_HELD: Final = 1e8


def rival_evidence(
    template: NDArray[np.float32],
    image: NDArray[np.float32],
    first: NDArray[np.int32],
    last: NDArray[np.int32],
    middle: float,
    warp: NDArray[np.float64],
    information: NDArray[np.float64],
    stiffness: NDArray[np.float64],
    correlated_px: float,
) -> float:
    """Evidence for a warp against the best of its rivals.

    Parameters
    ----------
    template, image : numpy.ndarray
        (n, n) float32: both frames at half resolution.
    first, last : numpy.ndarray
        (n,) int32: lit columns of each row.
    middle : float
        Row of the bundle's centre at half resolution.
    warp, information, stiffness : numpy.ndarray
        (4,) warp in pixels of full resolution, its (4, 4) information, and what of that was known beforehand.
    correlated_px : float
        Pixels of full resolution that share one noise value.

    Returns
    -------
    float
        Nats per pixel of the overlap, 0.5 ln((1 - rival^2) / (1 - found^2)) of the correlations; 0 where nothing is
        known.
    """
    try:
        covariance = np.linalg.inv(information).astype(np.float64)
    except np.linalg.LinAlgError:
        return 0.0
    variances, directions = np.linalg.eigh(covariance[np.ix_((1, 3), (1, 3))])
    if not variances[0] > 0:
        return 0.0
    best = best_rival(
        template, image, first, last, middle, warp, covariance, stiffness, directions, variances, correlated_px / 4
    )
    return float(best)


@kernel
def best_rival(
    template: NDArray[np.float32],
    image: NDArray[np.float32],
    first: NDArray[np.int32],
    last: NDArray[np.int32],
    middle: float,
    warp: NDArray[np.float64],
    covariance: NDArray[np.float64],
    stiffness: NDArray[np.float64],
    directions: NDArray[np.float64],
    variances: NDArray[np.float64],
    correlated_px: float,
) -> float:
    """Evidence against the best of six rivals.

    A rival is displaced along the direction of the shift that is known least, or best; it is then fitted to the frames
    itself, but for the shift along that direction. A fibre slides along itself, and turned a little, unnoticed.
    """
    unit = np.array([1.0, 2.0, 1.0, 2.0])
    information = np.empty((4, 4))
    rho, count = correlation(template, image, first, last, middle, warp / unit, 1)
    if count == 0:
        return 0.0
    found = 1 - min(max(rho, 0.0), 0.999) ** 2
    smallest = np.inf
    for k in range(6):
        axis, steps = (1, 1.0 + k // 2) if k < 4 else (0, 1.0)
        shift = (1 - 2 * (k % 2)) * steps * RIVAL_PX
        across, along = directions[0, axis], directions[1, axis]
        rival = warp.copy()
        for i in range(4):
            rival[i] += shift * (covariance[i, 1] * across + covariance[i, 3] * along) / variances[axis]
        rival /= unit
        held = stiffness.copy()
        held[1, 1] += _HELD * across * across
        held[1, 3] += _HELD * across * along
        held[3, 1] += _HELD * across * along
        held[3, 3] += _HELD * along * along
        for i in range(4):
            for j in range(4):
                held[i, j] *= unit[i] * unit[j]
        rho, count = align(
            template, image, first, last, middle, 1, 3, 0.02, rival.copy(), held, correlated_px, rival, information
        )
        smallest = min(smallest, 0.5 * np.log((1 - min(max(rho, 0.0), 0.999) ** 2) / found))
    return float(smallest)
