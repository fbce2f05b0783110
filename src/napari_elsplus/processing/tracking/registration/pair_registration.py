"""The warp between two frames, with the evidence for it: correlation, covariance, and whether another would do as well.

Three stages: from the predicted warp, or else from the best few peaks of a masked correlation over all shifts, down a
pyramid of Lucas-Kanade steps to full resolution; then the link's rivals are tried, to see whether a shift a few pixels
away explains the frames as well, as it does along a straight fibre or where there is nothing to see.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import hypot, inf, isfinite, nan
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from napari_elsplus.processing.tracking.front_end.grid import FIELD, INNER_FIELD, overlap_of_discs
from napari_elsplus.processing.tracking.motion.rolling_shutter import Displacement, Velocity, Warp
from napari_elsplus.processing.tracking.registration import motion_models as ladder
from napari_elsplus.processing.tracking.registration.evidence import RIVAL_PX, evidence_between, weakest_direction
from napari_elsplus.processing.tracking.registration.lucas_kanade import Workspace
from napari_elsplus.processing.tracking.registration.pyramid_descent import (
    CORRELATED_PX,
    LEVELS,
    align_candidate,
    fill_coarser,
    link_levels,
)
from napari_elsplus.processing.tracking.registration.shift_search import LEAST_OVERLAP, ShiftSearch, prior, support

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.front_end.grid import Grid

LEAST_EVIDENCE: Final = 0.1
"""Evidence that a link needs against each of its rivals, in nats per pixel."""
EVIDENCE_AT_REST: Final = 0.2
"""The same where nothing seems to have moved: what the flat field leaves of the bundle's own pattern never moves."""
_AT_REST_PX: Final = 2.0
_AT_REST: Final = Velocity(0.0, 0.0)
_TELLING_PX: Final = 0.1
_SURE: Final = 0.9
_TURNS: Final = 4
_SMALL_TURN: Final = 0.004
"""Angle, in radians, up to which one linear step is exact enough: half a pixel at the rim."""


@dataclass(slots=True)
class PreparedFrame:
    """A tracking image at full, half and quarter resolution, and its spectra once they are asked for.

    The arrays belong to the view and are filled anew by :meth:`Registrar.prepare`.
    """

    levels: tuple[NDArray[np.float32], ...]
    spectra: NDArray[np.complex64] | None = field(default=None, repr=False)
    bare: tuple[NDArray[np.float32], ...] | None = field(default=None, repr=False)
    """The levels without what is smooth in them, once they are asked for."""

    @property
    def image(self) -> NDArray[np.float32]:
        """The image at full resolution."""
        return self.levels[0]


class PairRegistration(NamedTuple):
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
        For this warp and against the best of its rivals, nats per pixel; 0 where frames were looked at again.
    turn : float
        Angle of the later frame less that of the earlier one, radians.
    zoom : float
        Scale of the later frame over that of the earlier one.
    turn_sigma : float
        One standard deviation of the angle, and of the scale; infinite where no rotation was asked for.
    again : float
        Where frames were looked at again, the evidence then, over what is needed; else nan.
    """

    warp: Warp
    information: NDArray[np.float64]
    correlation: float
    overlap: float
    evidence: float = 0.0
    turn: float = 0.0
    zoom: float = 1.0
    turn_sigma: float = inf
    again: float = nan

    @property
    def observed(self) -> bool:
        """Whether the frames themselves say that this is the shift, and no other near it."""
        return self.stands()

    def stands(self, times: float = 1.0) -> bool:
        """Whether the frames say so with that many times the evidence that is needed."""
        return self.overlap >= LEAST_OVERLAP and self.certainty >= times

    @property
    def certainty(self) -> float:
        """How many times the evidence that is needed was found."""
        if isfinite(self.again):
            return self.again
        at_rest = hypot(self.warp.b, self.warp.d) < _AT_REST_PX
        return self.evidence / (EVIDENCE_AT_REST if at_rest else LEAST_EVIDENCE)

    @property
    def sigma(self) -> float:
        """Larger axis of the shift's uncertainty, one standard deviation in pixels."""
        return float(weakest_direction(self.information)[0])

    @property
    def tells_turn(self) -> bool:
        """Whether there is enough in view to tell a turn from a stretch: one or two fibres do not."""
        return not isfinite(self.again) or self.sigma < _TELLING_PX

    @property
    def covariance(self) -> NDArray[np.float64]:
        """(2, 2) covariance of the shift (rows, cols), px squared."""
        try:
            return np.ascontiguousarray(np.linalg.inv(self.information)[np.ix_((1, 3), (1, 3))])
        except np.linalg.LinAlgError:
            return np.full((2, 2), np.inf) * np.eye(2)


class Registrar:
    """Registers frames on one grid; keeps what depends on the grid alone. Not for two threads at once.

    Parameters
    ----------
    grid : Grid
        The grid of the tracking images.
    """

    def __init__(self, grid: Grid) -> None:
        self.grid = grid
        self._spans = [grid.spans(level=level) for level in range(LEVELS)]
        self._lit = np.zeros((LEVELS + 1, 2, grid.side), np.int32)
        for columns, spans in zip(self._lit, (*self._spans, grid.spans(INNER_FIELD)), strict=True):
            columns[:, : len(spans[0])] = spans
        self._middles = tuple(grid.middle(level) for level in range(LEVELS))
        self._centre = self._middles[1], (grid.centre[1] - 0.5) / 2
        self.work = Workspace.of(grid.side)
        self._everywhere = ShiftSearch(*self._spans[-1], 2.0 ** (LEVELS - 1))

    def view(self) -> PreparedFrame:
        """Return an empty view, to be filled again and again."""
        side = self.grid.side
        return PreparedFrame(tuple(np.zeros((side >> level, side >> level), np.float32) for level in range(LEVELS)))

    def prepare(self, view: PreparedFrame) -> PreparedFrame:
        """Fill the coarser levels from the image at full resolution.

        Parameters
        ----------
        view : PreparedFrame
            Of which the image was filled.
        """
        view.spectra = view.bare = None
        fill_coarser(view.levels)
        return view

    def link(
        self, earlier: PreparedFrame, later: PreparedFrame, expected: Warp, spread: tuple[float, float]
    ) -> PairRegistration:
        """Refine the expected warp and judge the result.

        Parameters
        ----------
        earlier, later : PreparedFrame
            Prepared frames.
        expected : Warp
            Where to start.
        spread : tuple of float
            Standard deviations beforehand of the stretch a and the shear s about their expected values.
        """
        warp, information = np.array(expected, float), np.empty((4, 4))
        correlation, evidence = link_levels(
            earlier.levels, later.levels, self._lit, self._middles, (spread[0] ** -2, spread[1] ** -2),
            warp, information, self.work,
        )  # fmt: skip
        overlap = overlap_of_discs(hypot(warp[1], warp[3]) / (FIELD * self.grid.diameter))
        return PairRegistration(Warp(*warp.tolist()), information, correlation, overlap, evidence)

    def remainder(
        self,
        earlier: PreparedFrame,
        later: PreparedFrame,
        warp: Warp,
        spread: tuple[float, float],
        turn: tuple[float, float] = (0.0, inf),
    ) -> ladder.Remainder | None:
        """Ask what rotation and scale would add to a warp, where such a rotation is expected, give or take as much.

        None where the frames say nothing.

        Parameters
        ----------
        earlier, later : PreparedFrame
            Prepared frames.
        warp : Warp
            Registered warp.
        spread : tuple of float
            As in :meth:`link`.
        turn : tuple of float
            Rotation that is expected, radians, and its standard deviation.
        """
        first, last = self._spans[1]
        stiffness = spread[0] ** -2, spread[1] ** -2
        return ladder.remainder(
            earlier.levels[1], later.levels[1], first, last, self._centre, warp, 2.0, stiffness, CORRELATED_PX / 4, turn
        )

    def turned(
        self, view: PreparedFrame, velocity: Velocity, turn: float, zoom: float, out: PreparedFrame
    ) -> PreparedFrame:
        """Fill a view with another, freed of its motion, and turned and scaled to match a later one.

        Parameters
        ----------
        view : PreparedFrame
            The earlier frame.
        velocity : Velocity
            Its own.
        turn, zoom : float
            Angle (radians) and scale of the later frame over this one's.
        out : PreparedFrame
            What is filled, and returned.
        """
        unsheared = ladder.unsheared(velocity, self.grid.shutter.line_periods_per_frame)
        matrix = ladder.turned_by(-turn, 1 / zoom) @ unsheared
        ladder.upright(view.image, out.image, self.grid.centre, matrix)
        return self.prepare(out)

    def turned_link(
        self,
        earlier: PreparedFrame,
        later: PreparedFrame,
        expected: tuple[float, float, float, float],
        velocities: tuple[Velocity, Velocity],
        spread: tuple[float, float],
        rung: ladder.MotionModel,
        scratch: PreparedFrame,
        reach_px: float | None = None,
        turn_spread: float = inf,
    ) -> PairRegistration | None:
        """Refine a warp between frames one of which may be turned against the other.

        Parameters
        ----------
        earlier, later : PreparedFrame
            Prepared frames.
        expected : tuple of float
            Displacement (row, col) in the later frame's orientation, and its turn and zoom against the earlier one.
        velocities : tuple of Velocity
            Of the earlier frame, and what is expected of the later one's.
        spread : tuple of float
            As in :meth:`link`.
        rung : Rung
            What is modelled.
        scratch : PreparedFrame
            Is filled with the earlier frame, turned.
        reach_px : float, optional
            All shifts are searched, with a prior of that scale; from what is expected alone by default.
        turn_spread : float
            Standard deviation of the turn about what is expected, radians. In a view with one fibre a turn and a shift
            look alike.

        Returns
        -------
        PairRegistration or None
            Its warp is the one that frames of the same orientation would have had. None where nothing was found.
        """
        shutter, before = self.grid.shutter, velocities[0]
        row, col, turn, zoom = expected
        start = shutter.warp(_AT_REST, velocities[1], Displacement(row, col))
        link: PairRegistration | None = None
        sigma = inf
        for _ in range(_TURNS):
            upright = self.turned(earlier, before, turn, zoom, scratch)
            link = self.link(upright, later, start, spread)
            if reach_px is not None and not (link.observed and link.correlation > _SURE):
                link = self.search(upright, later, start, spread, reach_px)
            left = turn - expected[2], turn_spread
            found = None if link is None else self.remainder(upright, later, link.warp, spread, left)
            if link is None or found is None:
                return None
            start, form = ladder.composed(link.warp, found.step[rung])
            more = ladder.angle_of(form)
            turn, zoom, sigma = turn - more, zoom / ladder.scale_of(form), float(found.sigma[0])
            if abs(more) < _SMALL_TURN:
                break
        assert link is not None
        stretch, shear = 1 + before.row / shutter.line_periods_per_frame, before.col / shutter.line_periods_per_frame
        warp = Warp(start.a * stretch, start.b, start.s * stretch + shear, start.d)
        return link._replace(warp=warp, turn=turn, zoom=zoom, turn_sigma=sigma)

    def search(
        self, earlier: PreparedFrame, later: PreparedFrame, expected: Warp, spread: tuple[float, float], reach_px: float
    ) -> PairRegistration | None:
        """Find the warp among all shifts; None where no shift is supported at all.

        Parameters
        ----------
        earlier, later : PreparedFrame
            Prepared frames.
        expected : Warp
            What the motion so far suggests; a heavy-tailed prior of scale `reach_px` is centred on it.
        spread : tuple of float
            As in :meth:`link`.
        reach_px : float
            How far the shift may well be from what is expected.
        """
        found: list[tuple[float, float, Warp]] = []
        first, last = self._spans[1]
        for shift in self.candidates(earlier, later, expected, reach_px):
            warp = np.array([expected.a, shift[0], expected.s, shift[1]])
            ncc, count = align_candidate(
                earlier.levels[1], later.levels[1], first, last, self._middles[1], warp, self.work
            )
            likely = support(np.array(ncc), np.array(count / 4))
            score = float(likely + prior(warp[1] - expected.b, warp[3] - expected.d, reach_px))
            if ncc > 0:
                found.append((score, ncc, Warp(*warp.tolist())))
        if not found:
            return None
        _, ncc, best = max(found)
        link = self.link(earlier, later, best, spread)
        others = [o for _, o, w in found if hypot(w.b - best.b, w.d - best.d) > RIVAL_PX]
        against = min((float(evidence_between(ncc, other)) for other in others), default=np.inf)
        return link._replace(evidence=min(link.evidence, against))

    def candidates(
        self, earlier: PreparedFrame, later: PreparedFrame, expected: Warp, reach_px: float
    ) -> NDArray[np.float64]:
        """Return the few shifts (b, d) that are most likely among all, best first.

        Parameters
        ----------
        earlier, later : PreparedFrame
            Prepared frames.
        expected : Warp
            Predicted warp.
        reach_px : float
            Scale of the prior about it, pixels.
        """
        return self._everywhere.peaks(self._spectra(earlier), self._spectra(later), expected, reach_px)

    def _spectra(self, view: PreparedFrame) -> NDArray[np.complex64]:
        if view.spectra is None:
            view.spectra = self._everywhere.spectra(view.levels[-1])
        return view.spectra
