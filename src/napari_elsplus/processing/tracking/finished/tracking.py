"""Tracking of finished images of any microscope: soft texture, large moves, frames without contact, repeated frames.

Each image is registered to the last tracked one over all shifts and accepted by its odds
(:mod:`~napari_elsplus.processing.tracking.finished.shift_odds`); the accepted shift is refined by
Lucas-Kanade. No rolling shutter is corrected: how other microscopes scan is unknown.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass
from math import hypot, log, nan
from typing import TYPE_CHECKING, Any, Final

import cv2
import numpy as np

from napari_elsplus.processing.tracking.finished.shift_odds import MIN_ODDS_NATS, ShiftOdds, SpectraOfImage
from napari_elsplus.processing.tracking.front_end.grid import FIELD, Grid
from napari_elsplus.processing.tracking.motion.pose import Pose, TrackingState
from napari_elsplus.processing.tracking.motion.rolling_shutter import Velocity, Warp
from napari_elsplus.processing.tracking.pose_graph.least_squares import Edge, least_squares_positions
from napari_elsplus.processing.tracking.registration.motion_models import MotionModel
from napari_elsplus.processing.tracking.registration.pair_registration import PreparedFrame, Registrar

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.finished.field import FinishedField

MAX_GAP_FRAMES: Final = 5
"""Frames without a registration after which a segment is not continued, as in the tracker of raw frames; segments are
joined when the stack is finished."""
REPEATED_NOISE: Final = 0.25
"""Difference of a repeated frame from its twin over the noise in either, standard deviations; chosen: two exposures
differ by 1.4, a recompressed copy by less than 0.1."""
MAX_JOINING_PAIRS: Final = 1000
"""Pairs of first and last frames of different segments that are compared to join these, the nearest in time first;
chosen, some 20 s."""
REFINED_DIAMETER_PX: Final = 240.0
"""Diameter to which fields are binned for the refinement, as raw frames are: finer than that, what is left of the cores
does not move with the tissue."""
_BINOMIAL: Final = np.array([1, 4, 6, 4, 1], np.float32) / 16
"""Smoothing of binned images, as of raw frames."""
_REFINED_CELLS: Final = 1.0
"""Distance of the refined shift from the searched one up to which it is used, cells; rigid images agree within half a
cell, while deforming tissue has no single shift, and a few bright details pull the refined one several pixels away."""
_SEARCH_SIGMA_CELLS: Final = 0.5
"""Standard deviation of a searched shift; chosen, about what parabolic peaks of soft texture scatter by."""
_SPREAD: Final = (1e-6, 1e-6)
"""Standard deviation of stretch and shear: there are none without a rolling shutter."""
_LAPLACIAN: Final = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32) / 6
"""Filter whose response to white noise has its standard deviation (Immerkaer 1996, doi:10.1006/cviu.1996.0060)."""
_AT_REST: Final = Velocity(0.0, 0.0)
_UNKNOWN: Final = Velocity(nan, nan)
_MAX_HELD: Final = 64
"""Frames whose spectra are held while segments are joined, some 2 MB each; chosen, others are computed again."""


@dataclass(slots=True)
class _Frame:
    """A frame that others can be registered to."""

    index: int
    view: PreparedFrame
    spectra: SpectraOfImage
    row: float = nan
    col: float = nan


@dataclass(frozen=True, slots=True)
class _Link:
    """An accepted registration: displacement of the probe from the earlier to the later frame, pixels."""

    edge: Edge
    score: float
    sigma: float


class FinishedTracking:
    """Tracks finished images; implements :class:`~.methods.TrackingMethod`.

    Parameters
    ----------
    field : FinishedField
        Field of view and static pattern of the stack.
    """

    scale = 1.0

    def __init__(self, field: FinishedField) -> None:
        self.grid = field.grid
        self._field = field
        self._odds = ShiftOdds(field.mask, field.coarse_diameter)
        self._binning = max(1, round(FIELD * self.grid.diameter / REFINED_DIAMETER_PX))
        self._registrar = Registrar(_binned(self.grid, self._binning))
        self._image = np.zeros((self.grid.side,) * 2, np.float32)
        y, x = (np.arange(self.grid.side) - c for c in self.grid.centre)
        self._inside = np.hypot(y[:, None], x) < 0.5 * FIELD * self.grid.diameter - 1
        self._tracked: _Frame | None = None
        self._previous: _Frame | None = None
        self._previous_image = np.zeros_like(self._image)
        self._pose = Pose(0, nan, nan, _UNKNOWN, nan, nan, TrackingState.LOST)
        self._twins: list[int] = []
        self._links: list[_Link] = []
        self._segment = -1
        self._untracked = 0

    def image(self, raw: NDArray[Any], raw_residual: NDArray[Any]) -> NDArray[np.float32]:
        """See :meth:`~.methods.TrackingMethod.image`."""
        self.prepare_image(raw, raw_residual, self._image)
        return self._image

    def prepare_image(self, raw: NDArray[Any], raw_residual: NDArray[Any], out: NDArray[np.float32]) -> None:
        """See :meth:`~.methods.TrackingMethod.prepare_image`."""
        out[:] = self._field.window(raw)

    def track(self, raw: NDArray[Any], raw_residual: NDArray[Any]) -> tuple[Pose, NDArray[np.float32]]:
        """See :meth:`~.methods.TrackingMethod.track`."""
        image = self.image(raw, raw_residual)
        return self.estimate_pose(image), image

    def estimate_pose(self, image: NDArray[np.float32]) -> Pose:
        """See :meth:`~.methods.TrackingMethod.estimate_pose`; a repeated frame has the pose of its twin."""
        index = len(self._twins)
        previous = self._previous
        if previous is not None and self._repeats(image, self._previous_image):
            self._twins.append(self._twins[-1])
            return self._pose
        self._twins.append(index)
        here = self._prepared(index, image)
        self._pose = self._continue(here) or self._start_segment(here)
        self._untracked = 0 if self._pose.state is TrackingState.TRACKED else self._untracked + 1
        self._previous = here
        self._previous_image[:] = image
        return self._pose

    def refine(self, poses: list[Pose], image: Callable[[int], NDArray[np.float32]]) -> list[Pose]:
        """Return the poses with segments joined, and lost frames where nothing is registered, but for a lone first one.

        Parameters
        ----------
        poses : list of Pose
            One for each frame so far.
        image : callable
            As of :meth:`~.methods.TrackingMethod.refine`.
        """
        edges = [link.edge for link in self._links]
        edges += self._joins(edges, image)
        found: dict[int, Pose] = {}
        for segment, members in enumerate(_components(edges)):
            own = [edge for edge in edges if edge.earlier in members]
            for index, (row, col) in least_squares_positions(own, min(members)).items():
                found[index] = Pose(segment, row, col, _AT_REST, nan, nan, TrackingState.TRACKED)
        if not found and self._twins:
            found[0] = Pose(0, 0.0, 0.0, _AT_REST, nan, nan, TrackingState.TRACKED)
        for link in self._links:
            index = link.edge.later
            found[index] = found[index]._replace(score=link.score, sigma=link.sigma)
        refined: list[Pose] = []
        segment = 0
        for twin in self._twins[: len(poses)]:
            pose = found.get(twin)
            segment = segment if pose is None else pose.segment
            refined.append(pose or Pose(segment, nan, nan, _UNKNOWN, nan, nan, TrackingState.LOST))
        return refined

    def discard_registrations(self) -> None:
        """See :meth:`~.methods.TrackingMethod.discard_registrations`."""
        self._links.clear()

    @property
    def newest_registration(self) -> None:
        """None: registrations of finished images do not carry live loop closure."""

    @property
    def motion_model(self) -> MotionModel:
        """Translation."""
        return MotionModel.TRANSLATION

    def _prepared(self, index: int, image: NDArray[np.float32]) -> _Frame:
        view = self._registrar.view()
        side, used = len(view.image), len(view.image) * self._binning
        binned = cv2.resize(image[:used, :used], (side, side), interpolation=cv2.INTER_AREA)
        view.image[:] = cv2.sepFilter2D(binned, -1, _BINOMIAL, _BINOMIAL) if self._binning > 1 else binned
        return _Frame(index, self._registrar.prepare(view), self._odds.spectra(self._field.coarse_logarithm(image)))

    def _continue(self, here: _Frame) -> Pose | None:
        """Register a frame to the newest tracked one of the segment."""
        last = self._tracked
        if last is None or self._untracked >= MAX_GAP_FRAMES:
            return None
        link = self._link(last, here)
        if link is None:
            return None
        down, across = link.edge.displacement
        here.row, here.col = last.row + down, last.col + across
        self._links.append(link)
        self._tracked = here
        return Pose(self._segment, here.row, here.col, _AT_REST, link.score, link.sigma, TrackingState.TRACKED)

    def _start_segment(self, here: _Frame) -> Pose:
        """Start a segment with a frame that registers on the one before, which is lost itself, or with the first."""
        previous = self._previous
        link = None
        if previous is not None and np.isnan(previous.row):
            link = self._link(previous, here)
        if link is None and previous is not None:
            return Pose(max(self._segment, 0), nan, nan, _UNKNOWN, nan, nan, TrackingState.LOST)
        self._segment += 1
        here.row = here.col = 0.0
        self._tracked = here
        if link is not None:
            self._links.append(link)
        score, sigma = (nan, nan) if link is None else (link.score, link.sigma)
        return Pose(self._segment, 0.0, 0.0, _AT_REST, score, sigma, TrackingState.TRACKED)

    def _link(self, earlier: _Frame, later: _Frame, more_odds: float = 0.0) -> _Link | None:
        """Register two frames; None where the odds are less than needed."""
        found = self._odds.best(earlier.spectra, later.spectra)
        if found.odds < MIN_ODDS_NATS + more_odds:
            return None
        px = self._field.pixels_per_cell
        row, col = found.row * px, found.col * px
        q = self._binning
        fine = self._registrar.link(earlier.view, later.view, Warp(1.0, row / q, 0.0, col / q), _SPREAD)
        covariance = (_SEARCH_SIGMA_CELLS * px) ** 2 * np.eye(2)
        refined = fine.correlation > 0 and hypot(q * fine.warp.b - row, q * fine.warp.d - col) < _REFINED_CELLS * px
        if refined and np.isfinite(fine.covariance).all():
            row, col, covariance = q * fine.warp.b, q * fine.warp.d, q**2 * fine.covariance + 1e-4 * np.eye(2)
        sigma = float(np.sqrt(np.linalg.eigvalsh(covariance)[-1]))
        return _Link(Edge(earlier.index, later.index, (-row, -col), covariance), found.correlation, sigma)

    def _repeats(self, image: NDArray[np.float32], before: NDArray[np.float32]) -> bool:
        """Return True if an image differs from the one before by less than two exposures do."""
        inside = self._inside
        difference = float(np.sqrt(np.mean((image - before)[inside] ** 2)))
        response = np.abs(cv2.filter2D(before, -1, _LAPLACIAN)[inside])
        noise = float(np.median(response)) / 0.6745
        return difference <= max(REPEATED_NOISE * noise, 0.5 * self._field.quantum)

    def _joins(self, edges: list[Edge], image: Callable[[int], NDArray[np.float32]]) -> list[Edge]:
        """Return registrations between segments: the more pairs are tried, the more odds each of them needs."""
        ends = [sorted(members) for members in _components(edges)]
        ends = [sorted({*frames[:2], *frames[-2:]}) for frames in ends]
        pairs = [
            (min(a, b), max(a, b)) for k, one in enumerate(ends) for other in ends[k + 1 :] for a in one for b in other
        ]
        pairs = sorted(pairs, key=lambda pair: pair[1] - pair[0])[:MAX_JOINING_PAIRS]
        held: OrderedDict[int, _Frame] = OrderedDict()

        def frame(index: int) -> _Frame:
            if index not in held:
                held[index] = self._prepared(index, image(index))
            held.move_to_end(index)
            if len(held) > _MAX_HELD:
                held.popitem(last=False)
            return held[index]

        joins = []
        for earlier, later in pairs:
            link = self._link(frame(earlier), frame(later), log(len(pairs)))
            if link is not None:
                joins.append(link.edge)
        return joins


def _binned(grid: Grid, binning: int) -> Grid:
    """Return a grid of coarser pixels; what is left over at its end is cut off."""
    row, col = ((c - (binning - 1) / 2) / binning for c in grid.centre)
    side = grid.side // binning // 4 * 4
    return Grid(side, binning, grid.origin, (row, col), grid.diameter / binning, grid.shutter)


def _components(edges: Iterable[Edge]) -> list[set[int]]:
    """Return the frames that edges connect, each set by its first frame in order."""
    groups: list[set[int]] = []
    for edge in edges:
        touched = [group for group in groups if edge.earlier in group or edge.later in group]
        groups = [group for group in groups if all(group is not other for other in touched)]
        groups.append({edge.earlier, edge.later}.union(*touched))
    return sorted(groups, key=min)
