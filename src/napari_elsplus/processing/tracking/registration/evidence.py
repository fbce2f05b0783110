"""Whether another shift would explain two frames as well: the gate of the tracker.

Along a straight fibre, in an empty view or under a lifted probe a correlation can be high and its shift wrong. So a
link is compared with its rivals: warps that are held a few pixels away, along the direction in which the shift is
known least, and otherwise fitted to the frames as well as they can be. What counts is how much worse the best of them
is.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.processing.compiled import lean_kernel
from napari_elsplus.processing.tracking.registration.lucas_kanade import align
from napari_elsplus.processing.tracking.registration.similarity import correlation

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.registration.lucas_kanade import Workspace

RIVAL_PX: Final = 4.0
"""Distance of the nearest rivals of a shift."""
HELD: Final = 1e8
"""Information that holds a rival where it is."""
_BEST_CORRELATION: Final = 0.995
_ROW_STEP: Final = 2
_STEPS: Final = 2
"""In which a rival is fitted: it starts near its best."""
_BEYOND_DOUBT: Final = 1.0
"""Evidence against the nearest rivals, nats per pixel, that makes farther ones needless."""


@lean_kernel
def rival_evidence(
    template: NDArray[np.float32],
    image: NDArray[np.float32],
    first: NDArray[np.int32],
    last: NDArray[np.int32],
    middle: float,
    warp: NDArray[np.float64],
    information: NDArray[np.float64],
    stiffness: tuple[float, float],
    correlated_px: float,
    work: Workspace,
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
    warp, information : numpy.ndarray
        (4,) warp in pixels of full resolution, and its (4, 4) information.
    stiffness : tuple of float
        Information on a and s that was there beforehand.
    correlated_px : float
        Pixels of full resolution that share one noise value.
    work : Workspace
        For frames of this size or larger.

    Returns
    -------
    float
        Nats per pixel of the overlap, 0.5 ln((1 - rival^2) / (1 - found^2)) of the correlations; 0 where nothing is
        known.
    """
    _, across, along, a_follows, s_follows = weakest_direction(information)
    if across == 0.0 and along == 0.0:
        return 0.0
    equations = work.equations
    held, scratch, rival, start = equations[3], equations[4], equations[5, 0], equations[5, 1]
    held[:] = 0.0
    held[0, 0], held[2, 2] = stiffness
    held[1, 1] = 4 * HELD * across * across  # in pixels of half resolution
    held[1, 3] = held[3, 1] = 4 * HELD * across * along
    held[3, 3] = 4 * HELD * along * along
    in_pixels_of(2.0, (warp[0], warp[1], warp[2], warp[3]), start)
    rho, count = correlation(template, image, first, last, middle, start, _ROW_STEP)
    if count == 0:
        return 0.0
    smallest = np.inf
    for k in range(4):
        if k == 2 and smallest > _BEYOND_DOUBT:
            break
        shift = RIVAL_PX * (1 + k // 2) * (1 - 2 * (k % 2))
        a, b = warp[0] + shift * a_follows, warp[1] + shift * across
        s, d = warp[2] + shift * s_follows, warp[3] + shift * along
        in_pixels_of(2.0, (a, b, s, d), start)
        in_pixels_of(2.0, (a, b, s, d), rival)
        align(
            template, image, first, last, middle, _ROW_STEP, _STEPS, 0.02, False, start, held, correlated_px, rival,
            scratch, work,
        )  # fmt: skip
        other, _ = correlation(template, image, first, last, middle, rival, _ROW_STEP)
        smallest = min(smallest, evidence_between(rho, other))
    return float(smallest)


@lean_kernel
def in_pixels_of(px: float, warp: tuple[float, ...], out: NDArray[np.float64]) -> None:
    """Write a warp in pixels of another size.

    Parameters
    ----------
    px : float
        Size of the other pixels, in present ones.
    warp : tuple of float
        a, b, s, d.
    out : numpy.ndarray
        (4,) float64, filled.
    """
    out[0], out[1], out[2], out[3] = warp[0], warp[1] / px, warp[2], warp[3] / px


@lean_kernel
def evidence_between(found: float, other: float) -> float:
    """Evidence of one correlation against another, nats per pixel.

    Better agreement than what is left of the core pattern allows is chance, and not counted.

    Parameters
    ----------
    found, other : float
        Correlations under a warp and under its rival.
    """
    explained, rival = min(max(found, 0.0), _BEST_CORRELATION), min(max(other, 0.0), _BEST_CORRELATION)
    return float(0.5 * np.log((1 - rival**2) / (1 - explained**2)))


@lean_kernel
def weakest_direction(information: NDArray[np.float64]) -> tuple[float, float, float, float, float]:
    """How well a shift is known in the direction in which it is known least.

    Returns one standard deviation in pixels, the direction (rows, cols), and what stretch and shear do per pixel along
    it; infinite and zero where nothing is known.

    Parameters
    ----------
    information : numpy.ndarray
        (4, 4) inverse covariance of a, b, s, d.
    """
    aa, shear, ss = information[0, 0], information[0, 2], information[2, 2]
    determinant = aa * ss - shear * shear
    if not determinant > 0:
        return np.inf, 0.0, 0.0, 0.0, 0.0
    # how stretch and shear make up for a shift; what is left is known of the shift itself
    ab, sb, ad, sd = information[0, 1], information[2, 1], information[0, 3], information[2, 3]
    a_row, s_row = -(ss * ab - shear * sb) / determinant, -(aa * sb - shear * ab) / determinant
    a_col, s_col = -(ss * ad - shear * sd) / determinant, -(aa * sd - shear * ad) / determinant
    rows = information[1, 1] + ab * a_row + sb * s_row
    both = information[1, 3] + ab * a_col + sb * s_col
    cols = information[3, 3] + ad * a_col + sd * s_col
    if not (rows > 0 and cols > 0):
        return np.inf, 0.0, 0.0, 0.0, 0.0
    angle = 0.5 * np.arctan2(2 * both, rows - cols)  # of the direction known best
    across, along = -np.sin(angle), np.cos(angle)
    known = across * across * rows + 2 * across * along * both + along * along * cols
    return (
        1 / np.sqrt(known) if known > 0 else np.inf,
        across,
        along,
        a_row * across + a_col * along,
        s_row * across + s_col * along,
    )


@lean_kernel
def stretch_and_shear_variance(information: NDArray[np.float64]) -> tuple[float, float]:
    """How well the stretch a and the shear s are known, whatever the shift is; infinite where they are not.

    Parameters
    ----------
    information : numpy.ndarray
        (4, 4) inverse covariance of a, b, s, d.
    """
    bb, bd, dd = information[1, 1], information[1, 3], information[3, 3]
    determinant = bb * dd - bd * bd
    if not determinant > 0:
        return np.inf, np.inf
    ab, ad, sb, sd = information[0, 1], information[0, 3], information[2, 1], information[2, 3]
    aa = information[0, 0] - (dd * ab * ab - 2 * bd * ab * ad + bb * ad * ad) / determinant
    ss = information[2, 2] - (dd * sb * sb - 2 * bd * sb * sd + bb * sd * sd) / determinant
    both = information[0, 2] - (dd * ab * sb - bd * (ab * sd + ad * sb) + bb * ad * sd) / determinant
    left = aa * ss - both * both
    return (ss / left, aa / left) if left > 0 else (np.inf, np.inf)
