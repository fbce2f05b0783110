"""The warp between two frames, with the evidence for it: correlation, covariance, and whether another would do as well.

Three stages: from the predicted warp, or else from the best few peaks of a masked correlation over all shifts, down a
pyramid of Lucas-Kanade steps to full resolution; then the link's rivals are tried, to see whether a shift a few pixels
away explains the frames as well, as it does along a straight fibre or where there is nothing to see.

References
----------
Padfield, IEEE Trans. Image Process. 21, 2706 (2012), doi:10.1109/TIP.2011.2181402 (masked correlation).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, NamedTuple

import cv2
import numpy as np
from scipy import fft

from napari_elsplus.compiled import kernel
from napari_elsplus.processing.lucas_kanade import align, correlation
from napari_elsplus.processing.motion import Warp

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.processing.frontend import Grid

LEVELS: Final = 3
RIVAL_PX: Final = 4.0
"""Distance of the nearest rivals of a shift."""
LEAST_EVIDENCE: Final = 0.15
"""Evidence that a link needs against each of its rivals, in nats per pixel."""
LEAST_OVERLAP: Final = 0.15
"""Part of the disc that two frames must share."""
_CORRELATED_PX: Final = 20.0
"""Pixels that share one noise value: the front end smooths, and the core pattern is correlated."""
_CANDIDATES: Final = 6
_HIGH_PASS_CELLS: Final = 4.0


@dataclass(slots=True)
class View:
    """A tracking image at full, half and quarter resolution, and its spectra once they are asked for.

    The arrays belong to the view and are filled anew by :meth:`Registrar.prepare`.
    """

    levels: tuple[NDArray[np.float32], ...]
    spectra: NDArray[np.complex64] | None = field(default=None, repr=False)

    @property
    def image(self) -> NDArray[np.float32]:
        """The image at full resolution."""
        return self.levels[0]


class Link(NamedTuple):
    """How one frame lies on another.

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
    evidence : float
        For this warp and against the best of its rivals, nats per pixel.
    """

    warp: Warp
    information: NDArray[np.float64]
    correlation: float
    overlap: float
    evidence: float

    @property
    def observed(self) -> bool:
        """Whether the frames themselves say that this is the shift, and no other near it."""
        return self.evidence >= LEAST_EVIDENCE and self.overlap >= LEAST_OVERLAP

    @property
    def covariance(self) -> NDArray[np.float64]:
        """(2, 2) covariance of the shift (rows, cols), px squared."""
        try:
            return np.ascontiguousarray(np.linalg.inv(self.information)[np.ix_((1, 3), (1, 3))])
        except np.linalg.LinAlgError:
            return np.full((2, 2), np.inf) * np.eye(2)


class Registrar:
    """Registers frames on one grid; keeps what depends on the grid alone.

    Parameters
    ----------
    grid : Grid
        The grid of the tracking images.
    """

    def __init__(self, grid: Grid) -> None:
        self.grid = grid
        self._spans = [grid.spans(level=level) for level in range(LEVELS)]
        self._middles = [grid.middle(level) for level in range(LEVELS)]
        self._pixels = [float((last - first).sum()) for first, last in self._spans]
        coarse = grid.side >> (LEVELS - 1)
        first, last = self._spans[-1]
        columns = np.arange(coarse)
        self._mask = ((columns >= first[:, None]) & (columns < last[:, None])).astype(np.float32)
        self._size = cv2.getOptimalDFTSize(2 * coarse)
        self._mask_spectrum = fft.rfft2(self._mask, (self._size, self._size))
        self._overlap = self._correlate(self._mask_spectrum, self._mask_spectrum)
        self._local_weight = np.maximum(cv2.GaussianBlur(self._mask, (0, 0), _HIGH_PASS_CELLS), 1e-3)

    def view(self) -> View:
        """Return an empty view, to be filled again and again."""
        side = self.grid.side
        return View(tuple(np.zeros((side >> level, side >> level), np.float32) for level in range(LEVELS)))

    def prepare(self, view: View) -> View:
        """Fill the coarser levels from the image at full resolution."""
        view.spectra = None
        for fine, coarse in zip(view.levels, view.levels[1:], strict=False):
            halve(fine, coarse)
        return view

    def link(self, earlier: View, later: View, expected: Warp, spread: tuple[float, float]) -> Link:
        """Refine the expected warp and judge the result.

        Parameters
        ----------
        earlier, later : View
            Prepared frames.
        expected : Warp
            Where to start.
        spread : tuple of float
            Standard deviations beforehand of the stretch a and the shear s about their expected values.
        """
        warp = np.array(expected, float)
        information = np.empty((4, 4))
        stiffness = np.diag([spread[0] ** -2, 0.0, spread[1] ** -2, 0.0])
        scores = self._descend(earlier, later, warp, stiffness, information)
        evidence = self._evidence(earlier, later, warp, information, stiffness)
        return Link(Warp(*warp.tolist()), information, scores[0], scores[1] / self._pixels[0] * _ROW_STEP, evidence)

    def search(
        self, earlier: View, later: View, expected: Warp, spread: tuple[float, float], reach_px: float
    ) -> Link | None:
        """Find the warp among all shifts; None where no shift is supported at all.

        Parameters
        ----------
        earlier, later : View
            Prepared frames.
        expected : Warp
            What the motion so far suggests; a heavy-tailed prior of scale `reach_px` is centred on it.
        spread : tuple of float
            As in :meth:`link`.
        reach_px : float
            How far the shift may well be from what is expected.
        """
        best, best_score = None, -np.inf
        for shift in self._peaks(earlier, later, expected, reach_px):
            warp = np.array([expected.a, shift[0], expected.s, shift[1]])
            ncc, count = self._half_resolution(earlier, later, warp)
            miss = (warp[1] - expected.b) ** 2 + (warp[3] - expected.d) ** 2
            score = float(_support(np.array(ncc), np.array(count / 4))) - 1.5 * np.log1p(miss / reach_px**2)
            if ncc > 0 and score > best_score:
                best, best_score = warp, score
        return None if best is None else self.link(earlier, later, Warp(*best.tolist()), spread)

    def _descend(
        self,
        earlier: View,
        later: View,
        warp: NDArray[np.float64],
        stiffness: NDArray[np.float64],
        information: NDArray[np.float64],
    ) -> tuple[float, float]:
        expected = warp.copy()
        scores = (0.0, 0.0)
        for level, steps, tolerance_px, row_step, stiff in _SCHEDULE:
            scale = 2.0**level
            unit = np.array([1.0, scale, 1.0, scale])
            scaled = warp / unit
            first, last = self._spans[level]
            scores = align(
                earlier.levels[level],
                later.levels[level],
                first,
                last,
                self._middles[level],
                row_step,
                steps,
                tolerance_px,
                expected / unit,
                _RIGID if stiff else stiffness * np.outer(unit, unit),
                _CORRELATED_PX / row_step / scale**2 if level == 0 else _CORRELATED_PX / scale**2,
                scaled,
                information,
            )
            if scores[0] == 0.0:
                break
            warp[:] = scaled * unit
        return scores

    def _half_resolution(self, earlier: View, later: View, warp: NDArray[np.float64]) -> tuple[float, float]:
        first, last = self._spans[1]
        scaled = warp / np.array([1.0, 2.0, 1.0, 2.0])
        score = align(
            earlier.levels[1],
            later.levels[1],
            first,
            last,
            self._middles[1],
            1,
            8,
            0.1,
            scaled.copy(),
            _RIGID,
            1.0,
            scaled,
            np.empty((4, 4)),
        )
        warp[:] = scaled * np.array([1.0, 2.0, 1.0, 2.0])
        return score

    def _evidence(
        self,
        earlier: View,
        later: View,
        warp: NDArray[np.float64],
        information: NDArray[np.float64],
        stiffness: NDArray[np.float64],
    ) -> float:
        """Evidence for a warp against the rivals that explain the frames next best but for a shift."""
        try:
            covariance = np.linalg.inv(information)
        except np.linalg.LinAlgError:
            return 0.0
        variances, directions = np.linalg.eigh(covariance[np.ix_((1, 3), (1, 3))])
        if not variances[0] > 0:
            return 0.0
        first, last = self._spans[1]
        return rival_evidence(
            earlier.levels[1], later.levels[1], first, last, self._middles[1], warp, covariance, stiffness, directions,
            variances, RIVAL_PX, _CORRELATED_PX / 4,
        )  # fmt: skip

    def _peaks(self, earlier: View, later: View, expected: Warp, reach_px: float) -> NDArray[np.float64]:
        """Shifts (b, d) in full-resolution pixels at the best peaks of the masked correlation, best first."""
        t, tt = self._spectra(earlier)
        i, ii = self._spectra(later)
        m = self._mask_spectrum
        n = np.maximum(self._overlap, 1.0)
        st, si = self._correlate(t, m), self._correlate(m, i)
        var_t = self._correlate(tt, m) - st * st / n
        var_i = self._correlate(m, ii) - si * si / n
        both = self._correlate(t, i) - st * si / n
        enough = (self._overlap > LEAST_OVERLAP * self._pixels[-1]) & (var_t > 0) & (var_i > 0)
        ncc = np.where(enough, both / np.sqrt(np.where(enough, var_t * var_i, 1.0)), 0.0)
        scale = 2.0 ** (LEVELS - 1)
        rows = fft.fftfreq(self._size, 1 / self._size) * scale
        miss = (rows[:, None] - expected.b) ** 2 + (rows - expected.d) ** 2
        score = _support(ncc, n) - 1.5 * np.log1p(miss / reach_px**2)
        score[~enough] = -np.inf
        neighbours = cv2.dilate(np.pad(score, 1, mode="wrap"), np.ones((3, 3), np.uint8))[1:-1, 1:-1]
        peaks = np.argwhere((score >= neighbours) & np.isfinite(score) & (ncc > 0))
        order = np.argsort(-score[tuple(peaks.T)])[:_CANDIDATES]
        shifts: NDArray[np.float64] = rows[peaks[order]]
        return shifts

    def _spectra(self, view: View) -> NDArray[np.complex64]:
        if view.spectra is None:
            image = view.levels[-1] * self._mask
            image -= self._mask * cv2.GaussianBlur(image, (0, 0), _HIGH_PASS_CELLS) / self._local_weight
            view.spectra = fft.rfft2(np.stack([image, image * image]), (self._size, self._size))
        return view.spectra

    def _correlate(self, template: NDArray[np.complex64], image: NDArray[np.complex64]) -> NDArray[np.float32]:
        result: NDArray[np.float32] = fft.irfft2(np.conj(template) * image, (self._size, self._size))
        return result


_ROW_STEP: Final = 2
_HELD: Final = 1e8
_RIGID: Final = np.diag([1e12, 0.0, 1e12, 0.0])
_SCHEDULE: Final = ((2, 12, 0.2, 1, True), (1, 10, 0.1, 1, False), (0, 6, 0.02, _ROW_STEP, False))
"""Level of the pyramid, steps, tolerance, every how many rows, whether only the translation is free."""


def _support(ncc: NDArray[np.float64], cells: NDArray[np.float64]) -> NDArray[np.float64]:
    """Log-likelihood of a shift, from its correlation over so many cells of quarter resolution."""
    result: NDArray[np.float64] = -0.05 * cells * np.log1p(-(np.clip(ncc, 0, 0.999) ** 2))
    return result


@kernel
def halve(fine: NDArray[np.float32], coarse: NDArray[np.float32]) -> None:
    """Fill `coarse` (n / 2, n / 2) with the means of two by two pixels of `fine`."""
    quarter = np.float32(0.25)
    for row in range(coarse.shape[0]):
        upper, lower, into = fine[2 * row], fine[2 * row + 1], coarse[row]
        for col in range(coarse.shape[1]):
            into[col] = quarter * (upper[2 * col] + upper[2 * col + 1] + lower[2 * col] + lower[2 * col + 1])


@kernel
def rival_evidence(
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
    distance_px: float,
    correlated_px: float,
) -> float:
    """Smallest evidence for a warp against its rivals, on images of half resolution, nats per pixel.

    A rival is displaced along the direction of the shift that is known least, or best; it is then fitted to the frames
    itself, but for the shift along that direction. A straight fibre slides along itself, and turned a little, unnoticed.
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
        shift = (1 - 2 * (k % 2)) * steps * distance_px
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
