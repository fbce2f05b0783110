"""A second look at two frames of which the first one did not say enough: little is in view, or something misleads.

What does not move with the tissue is taken away: a glow at the rim, where the line has left the bundle while the
residual is read, is a structure too, and where there is hardly another it holds a link back. Then the warp is refined
under all that is known of the motion (``motion.warp_prior``) and judged place by place
(:mod:`napari_elsplus.processing.tracking.registration.local_evidence`).
"""

from __future__ import annotations

from math import hypot, isfinite
from typing import TYPE_CHECKING, Final

import cv2
import numpy as np

from napari_elsplus.processing.tracking.front_end.grid import lit_pixels
from napari_elsplus.processing.tracking.motion.prediction import AT_REST
from napari_elsplus.processing.tracking.motion.rolling_shutter import Velocity, Warp
from napari_elsplus.processing.tracking.motion.warp_prior import warp_prior
from napari_elsplus.processing.tracking.registration.local_evidence import look_again, look_at_half
from napari_elsplus.processing.tracking.registration.local_noise import blocks
from napari_elsplus.processing.tracking.registration.pair_registration import PairRegistration, PreparedFrame, Registrar
from napari_elsplus.processing.tracking.registration.pyramid_descent import LEVELS, fill_coarser
from napari_elsplus.processing.tracking.registration.shift_search import prior, support

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.motion.warp_prior import WarpPrior

DOUBT: Final = 1.0
"""Evidence for a link, nats per pixel, below which it is looked at again."""
LEAST_OF_SOFT_LIGHT: Final = 0.3
"""Evidence, nats per pixel, that a link needs where nothing fine is to be seen."""
HIGH_PASS_PX: Final = 8.0
"""Sigma of what is taken away, pixels of full resolution."""
_LEAST_FINE: Final = 0.3
"""Part of the variance that must be left: what there is to see must not be taken away."""
_MOST_MISFIT: Final = 6.0
"""Standard deviations by which stretch and shear may miss what is expected of them."""
_ALIKE_PX: Final = 1.5
_COARSE_PX: Final = 2 ** (LEVELS - 1)
_LEAST_CORRELATION: Final = 0.3
"""Of a candidate of the search, at half resolution."""


def unlit(link: PairRegistration) -> PairRegistration:
    """Judge a doubtful link between frames in which nothing fine is to be seen: soft light has to say more.

    What is left of out-of-focus light in an empty view agrees at shifts that are wrong.
    """
    return link._replace(again=link.evidence / LEAST_OF_SOFT_LIGHT)


class LowTextureFallback:
    """Looks again at frames on one grid; keeps what depends on the grid alone.

    Parameters
    ----------
    registrar : Registrar
        That took the first look.
    """

    def __init__(self, registrar: Registrar) -> None:
        self._registrar = registrar
        grid = registrar.grid
        spans = [grid.spans(level=level) for level in range(LEVELS)]
        self._first, self._last = (tuple(span[end] for span in spans) for end in (0, 1))
        self._middles = tuple(grid.middle(level) for level in range(LEVELS))
        self._pixels = [float((last - first).sum()) for first, last in spans]
        self._sums = blocks(grid.side)
        self._lit = [lit_pixels(*grid.spans(1.0, level)).astype(np.float32) for level in (0, LEVELS - 1)]
        self._used = lit_pixels(*spans[1])
        self._weight = np.maximum(_blurred(self._lit[1]), 1e-3)

    def link(self, earlier: PreparedFrame, later: PreparedFrame, known: WarpPrior) -> PairRegistration | None:
        """Refine the expected warp; None where there is nothing fine to be seen.

        Parameters
        ----------
        earlier, later : PreparedFrame
            Prepared frames.
        known : WarpPrior
            Where to start, and what is known of it.
        """
        return self._refined(earlier, later, known, np.array(known.expected), LEVELS - 1)

    def search(
        self, earlier: PreparedFrame, later: PreparedFrame, known: WarpPrior, reach_px: float
    ) -> PairRegistration | None:
        """Find the warp among all shifts; None where there is nothing fine to be seen.

        Parameters
        ----------
        earlier, later : PreparedFrame
            Prepared frames.
        known : WarpPrior
            What is known of the warp.
        reach_px : float
            Scale of a heavy-tailed prior about the expected shift.
        """
        bare = self._bare(earlier), self._bare(later)
        if not all(bare):
            return None
        expected = np.array(known.expected)
        best: tuple[float, NDArray[np.float64]] | None = None
        for b, d in self._registrar.candidates(earlier, later, known.expected, reach_px):
            warp = np.array(known.at(b, d))
            correlation, count = look_at_half(
                bare[0][1], bare[1][1], self._first[1], self._last[1], self._middles[1],
                expected, known.terms, warp, self._registrar.work,
            )  # fmt: skip
            if correlation < _LEAST_CORRELATION:
                continue
            miss = warp[1] - known.expected.b, warp[3] - known.expected.d
            score = float(support(np.array(correlation), np.array(count / 4)) + prior(*miss, reach_px))
            if best is None or score > best[0]:
                best = score, warp
        return None if best is None else self._refined(earlier, later, known, best[1], 1)

    def confirmed(
        self, link: PairRegistration, earlier: PreparedFrame, later: PreparedFrame,
        velocities: tuple[Velocity, Velocity], spread_px: float, scratch: PreparedFrame, trust_px: float | None = None,
    ) -> PairRegistration:  # fmt: skip
        """Look again, where a doubtful link leads, at frames one of which may be turned; return it with what is seen.

        Parameters
        ----------
        link : PairRegistration
            Returned as it is where it leaves no doubt.
        earlier, later : PreparedFrame
            Prepared frames.
        velocities : tuple of Velocity
            Theirs.
        spread_px : float
            What these are trusted to.
        scratch : PreparedFrame
            Is filled with the earlier frame, turned.
        trust_px : float, optional
            How well the earlier one is known, if the frames are successive.
        """
        if link.evidence >= DOUBT:
            return link
        before, after = velocities
        shutter = self._registrar.grid.shutter
        moved = shutter.displacement(link.warp, after)
        if trust_px is not None:  # the displacement is the mean of the velocities
            after = Velocity(*(2 * d - v for d, v in zip(moved, before, strict=True)))
        if isfinite(link.turn_sigma):
            earlier = self._registrar.turned(earlier, before, link.turn, link.zoom, scratch)
            before = AT_REST
        again = self.link(earlier, later, warp_prior(shutter, (before, after), moved, spread_px, trust_px))
        if again is None:
            return unlit(link)
        alike = hypot(again.warp.b - link.warp.b, again.warp.d - link.warp.d) < _ALIKE_PX
        return link._replace(again=again.again if alike else 0.0)

    def _refined(
        self, earlier: PreparedFrame, later: PreparedFrame, known: WarpPrior, warp: NDArray[np.float64], coarsest: int
    ) -> PairRegistration | None:
        bare, information = (self._bare(earlier), self._bare(later)), np.empty((4, 4))
        if not all(bare):
            return None
        correlation, count, certainty = look_again(
            *bare, self._first, self._last, self._middles, coarsest,
            np.array(known.expected), known.terms, warp, information, self._sums, self._registrar.work,
        )  # fmt: skip
        if correlation == 0.0:
            return None
        found, overlap = Warp(*warp.tolist()), count / self._pixels[0]
        if known.misfit(found) > _MOST_MISFIT:
            certainty = min(certainty, 0.0)
        return PairRegistration(found, information, correlation, overlap, again=certainty)

    def _bare(self, view: PreparedFrame) -> tuple[NDArray[np.float32], ...]:
        """Return a view's levels without what is smooth in them, made once for each frame; empty if that is most."""
        if view.bare is None:
            fine, coarse = self._lit
            low = _blurred(view.levels[-1] * coarse) / self._weight
            smooth = cv2.resize(low, fine.shape[::-1], interpolation=cv2.INTER_LINEAR)
            bare = (view.image - smooth) * fine, *(np.empty_like(level) for level in view.levels[1:])
            fill_coarser(bare)
            there, left = (float(levels[1][self._used].var()) for levels in (view.levels, bare))
            view.bare = bare if left > _LEAST_FINE * there else ()
        return view.bare


def _blurred(image: NDArray[np.float32]) -> NDArray[np.float32]:
    smooth: NDArray[np.float32] = cv2.GaussianBlur(image, (0, 0), HIGH_PASS_PX / _COARSE_PX)
    return smooth
