"""Log posterior odds of a registered warp against competing shifts, in nats of the whole frame.

Along a straight fibre or in an empty view a correlation can be high and its shift wrong. A warp is therefore compared
with competing shifts along the direction in which the shift is constrained least, everything else fitted under the
motion prior. Each block of pixels has contrast and noise of its own, so that a bright, even fibre does not drown its
end, which alone constrains the shift along it: above a competing warp a block contributes half the residual that this
leaves more, over the noise. A fibre that slides along itself is seen through the same cores, which differ after
flat-fielding: what they may leave more is no evidence. Against unrelated frames the odds are those of the correlation r
of the whole overlap, n / 2 ln(1 / (1 - r^2)) with n independent values.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from napari_elsplus.processing.compiled import compilable, lean_kernel
from napari_elsplus.processing.tracking.front_end.sampling import row_shift, sampled, scratch
from napari_elsplus.processing.tracking.motion.motion_prior import DEGREES_OF_FREEDOM
from napari_elsplus.processing.tracking.motion.rolling_shutter import Warp
from napari_elsplus.processing.tracking.registration.lucas_kanade import Iteration, align

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.front_end.sampling import FramePair
    from napari_elsplus.processing.tracking.motion.motion_prior import Terms
    from napari_elsplus.processing.tracking.registration.lucas_kanade import Workspace

    Array = NDArray[np.float64]

CORRELATED_PX: Final = 20.0
"""Pixels of full resolution per independent noise value; the front end smooths over 13, interpolation over more."""
BLOCK_PX: Final = 8
"""Side of the blocks, pixels of half resolution."""
_FLOOR_DN2: Final = 0.3
_FLOOR_SHARE: Final = 0.01
"""Variance of the static pattern that flat-fielding leaves, which is no evidence: squared grey levels, and as a share
of the brightest block's variance; chosen: what a fibre leaves that was registered rightly."""
COMPETITORS_PX: Final = (4.0, -4.0, 8.0, -8.0)
"""Distances of competing shifts, pixels of full resolution: just wrong, and by a few pitches of the cores; chosen: with
12 and 16 as well as many registrations are wrong, and fewer right ones kept."""
_HELD: Final = 1e8
"""Information that holds a competing shift where it is, 1 / px^2."""
_FIT: Final = Iteration(2, 2, 0.02, False)
"""How competing warps are fitted at half resolution; likelihoods take all rows. In a kernel, elements of a tuple have
the types of variables, whereas each literal number would have what it is passed to compiled once more."""


class Blocks(NamedTuple):
    """Scratch of the odds; one for each thread.

    Parameters
    ----------
    sums : numpy.ndarray
        (6, blocks) float64: sums of every block.
    samples, others : numpy.ndarray
        From :func:`~.sampling.scratch`: a row of the image under either warp.
    """

    sums: Array
    samples: NDArray[np.float32]
    others: NDArray[np.float32]

    @classmethod
    def of(cls, side: int) -> Blocks:
        """Return those for frames of so many rows and columns at full resolution, `side`."""
        across = -(-(side // 2) // BLOCK_PX)
        return cls(np.zeros((6, across * across)), scratch(side // 2), scratch(side // 2))


@compilable
def log_ratio(pair: FramePair, warp: Warp, other: Warp, blocks: Blocks) -> float:
    """Return the log-likelihood of a warp above that of a competing one, where the frames overlap under both, nats.

    The noise of a block is what the warp leaves unexplained in it, its weight that of a Wiener filter.

    Parameters
    ----------
    pair : FramePair
        High-passed frames of half resolution.
    warp, other : Warp
        Both, in pixels of half resolution.
    blocks : Blocks
        For frames of this size.
    """
    template, image, sums, samples, others = pair.template, pair.image, blocks.sums, blocks.samples, blocks.others
    across = (len(template) + BLOCK_PX - 1) // BLOCK_PX
    sums[:] = 0.0
    for row in range(len(template)):
        above, down, whole, aside, begin, end = row_shift(pair, row, warp)
        above2, down2, whole2, aside2, begin2, end2 = row_shift(pair, row, other)
        begin, end = max(begin, begin2), min(end, end2)
        if end <= begin:
            continue
        sampled(image, above, down, begin + whole, aside, end - begin, samples)
        sampled(image, above2, down2, begin + whole2, aside2, end - begin, others)
        col = begin
        while col < end:
            block = row // BLOCK_PX * across + col // BLOCK_PX
            stop = min(end, (col // BLOCK_PX + 1) * BLOCK_PX)
            zero = np.float32(0)
            tt, ii, ti, ii2, ti2 = zero, zero, zero, zero, zero
            for k in range(col, stop):
                t, i, i2 = template[row, k], samples[k - begin], others[k - begin]
                tt += t * t
                ii += i * i
                ti += t * i
                ii2 += i2 * i2
                ti2 += t * i2
            for k, value in enumerate((np.float32(stop - col), tt, ii, ti, ii2, ti2)):
                sums[k, block] += value
            col = stop
    all_tt, all_ti, all_ti2 = sums[1].sum(), sums[3].sum(), sums[5].sum()
    if not all_tt > 0:
        return 0.0
    brightest = 0.0
    for block in range(sums.shape[1]):
        if sums[0, block] > BLOCK_PX:
            brightest = max(brightest, sums[1, block] / sums[0, block])
    floor = _FLOOR_DN2 + _FLOOR_SHARE * brightest
    gain, other_gain, nats = all_ti / all_tt, all_ti2 / all_tt, 0.0
    for block in range(sums.shape[1]):
        n, tt, ii, ti = sums[0, block], sums[1, block], sums[2, block], sums[3, block]
        if ti > 0:
            # weight of a Wiener filter: blocks without structure in common contribute chance alone
            shared = ti * ti / ((tt + n * floor) * (ii + n * floor))
            left = ii + gain * (gain * tt - 2 * ti)
            other_left = sums[4, block] + other_gain * (other_gain * tt - 2 * sums[5, block])
            more, static = other_left - left, n * floor
            more -= min(max(more, -static), static)
            nats += 0.5 * shared * n / (CORRELATED_PX / 4) * more / (left + static)
    return float(nats)


@lean_kernel
def write_prior(px: float, terms: Terms, weight: float, out: Array) -> None:
    """Write the information of the motion prior on a, b, s, d.

    Parameters
    ----------
    px : float
        Size of the pixels, in pixels of full resolution.
    terms : tuple of float
        :attr:`~.motion_prior.MotionPrior.terms`.
    weight : float
        From :func:`prior_terms`.
    out : numpy.ndarray
        (4, 4) float64 or larger, filled.
    """
    tie, slope = weight * terms[0], px * terms[1]
    out[:] = 0.0
    for k in (0, 2):
        out[k, k] = tie
        out[k, k + 1] = out[k + 1, k] = -tie * slope
        out[k + 1, k + 1] = tie * slope * slope


@lean_kernel
def prior_terms(warp: Warp, expected: Warp, terms: Terms) -> tuple[float, float]:
    """Return the weight of the motion prior at a warp, and minus its logarithm over that of the expected warp, nats.

    The prior is Student's t-distribution of shift, stretch and shear; the weight is that of the Gaussian that has its
    slope there.

    Parameters
    ----------
    warp, expected : Warp
        In pixels of full resolution.
    terms : tuple of float
        :attr:`~.motion_prior.MotionPrior.terms`.
    """
    tie, slope, of_shift = terms
    down, across = warp.b - expected.b, warp.d - expected.d
    stretch, shear = warp.a - expected.a - slope * down, warp.s - expected.s - slope * across
    surprise = of_shift * (down * down + across * across) + tie * (stretch * stretch + shear * shear)
    freedom = DEGREES_OF_FREEDOM + 4
    return freedom / (DEGREES_OF_FREEDOM + surprise), float(0.5 * freedom * np.log1p(surprise / DEGREES_OF_FREEDOM))


@lean_kernel
def log_odds_between(pair: FramePair, warp: Warp, other: Warp, expected: Warp, terms: Terms, blocks: Blocks) -> float:
    """Return the log odds of a registered warp against another one of the same frames, nats.

    Parameters
    ----------
    pair, blocks
        As in :func:`log_ratio`.
    warp, other : Warp
        Both, in pixels of full resolution.
    expected, terms
        As in :func:`prior_terms`.
    """
    nats = log_ratio(pair, in_pixels_of(2.0, warp), in_pixels_of(2.0, other), blocks)
    return nats + prior_terms(other, expected, terms)[1] - prior_terms(warp, expected, terms)[1]


@compilable
def log_odds(
    pair: FramePair, warp: Warp, information: Array, expected: Warp, terms: Terms, blocks: Blocks, work: Workspace
) -> float:
    """Return the log odds of a warp against competing ones along its weakest direction, nats; at most 700.

    Parameters
    ----------
    pair, blocks
        As in :func:`log_ratio`.
    warp, information : Warp, numpy.ndarray
        Registered warp in pixels of full resolution, and its (4, 4) information.
    expected, terms
        As in :func:`prior_terms`.
    work : Workspace
        For frames of this size or larger.
    """
    _, down, across, a_follows, s_follows = weakest_direction(information)
    if down == 0.0 and across == 0.0:
        return 0.0
    held, slope, against = work.stiffness, terms[1], 0.0
    # one competitor stands for all shifts that the prior allows
    alike = max(1.0, 1 / (terms[2] * COMPETITORS_PX[0] ** 2))
    for px in COMPETITORS_PX:
        b, d = warp.b + px * down, warp.d + px * across
        full = Warp(warp.a + px * a_follows, b, warp.s + px * s_follows, d)
        write_prior(2.0, terms, prior_terms(full, expected, terms)[0], held)
        # the prior's centre for this shift, at which it is held
        centre = Warp(expected.a + slope * (b - expected.b), b, expected.s + slope * (d - expected.d), d)
        held[1, 1] += 4 * _HELD * down * down
        held[1, 3] += 4 * _HELD * down * across
        held[3, 1] += 4 * _HELD * down * across
        held[3, 3] += 4 * _HELD * across * across
        rival, correlated_px = in_pixels_of(2.0, full), CORRELATED_PX / 4 / _FIT.row_step
        work.tone[0], work.tone[1] = 1.0, 0.0
        rival = align(pair, _FIT, in_pixels_of(2.0, centre), held, correlated_px, rival, work.schur, work)[2]
        less = log_odds_between(pair, warp, in_pixels_of(0.5, rival), expected, terms, blocks)
        against += alike * np.exp(-min(max(less, -700.0), 700.0))
    return float(-np.log(max(against, 1e-300)))


@lean_kernel
def in_pixels_of(px: float, warp: Warp) -> Warp:
    """Return a warp in pixels of another size.

    Parameters
    ----------
    px : float
        Size of the other pixels, in present ones.
    warp : Warp
        In present ones.
    """
    return Warp(warp.a, warp.b / px, warp.s, warp.d / px)


@lean_kernel
def weakest_direction(information: Array) -> tuple[float, float, float, float, float]:
    """Return the standard deviation of a shift in its least constrained direction, px, and that direction.

    That is (rows, cols) of a unit vector; last the change of stretch and shear per pixel along it. Infinite and zero
    where nothing is constrained.

    Parameters
    ----------
    information : numpy.ndarray
        (4, 4) inverse covariance of a, b, s, d.
    """
    aa, shear, ss = information[0, 0], information[0, 2], information[2, 2]
    determinant = aa * ss - shear * shear
    if not determinant > 0:
        return np.inf, 0.0, 0.0, 0.0, 0.0
    # how stretch and shear make up for a shift; what is left is information on the shift itself
    ab, sb, ad, sd = information[0, 1], information[2, 1], information[0, 3], information[2, 3]
    a_row, s_row = -(ss * ab - shear * sb) / determinant, -(aa * sb - shear * ab) / determinant
    a_col, s_col = -(ss * ad - shear * sd) / determinant, -(aa * sd - shear * ad) / determinant
    rows = information[1, 1] + ab * a_row + sb * s_row
    both = information[1, 3] + ab * a_col + sb * s_col
    cols = information[3, 3] + ad * a_col + sd * s_col
    if not (rows > 0 and cols > 0):
        return np.inf, 0.0, 0.0, 0.0, 0.0
    angle = 0.5 * np.arctan2(2 * both, rows - cols)  # of the best constrained direction
    across, along = -np.sin(angle), np.cos(angle)
    known = across * across * rows + 2 * across * along * both + along * along * cols
    sigma = 1 / np.sqrt(known) if known > 0 else np.inf
    return sigma, across, along, a_row * across + a_col * along, s_row * across + s_col * along
