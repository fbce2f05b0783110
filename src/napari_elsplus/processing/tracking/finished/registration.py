"""Registration of two finished images: accepted by the odds of the shift, refined by Lucas-Kanade where it is rigid."""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot, log, nan
from typing import TYPE_CHECKING, Final

import cv2
import numpy as np

from napari_elsplus.processing.tracking.finished.shift_odds import MIN_ODDS_NATS, ShiftOdds, SpectraOfImage
from napari_elsplus.processing.tracking.front_end.grid import FIELD, Grid
from napari_elsplus.processing.tracking.motion.motion_prior import MotionPrior
from napari_elsplus.processing.tracking.motion.rolling_shutter import Displacement, Velocity
from napari_elsplus.processing.tracking.pose_graph.least_squares import Edge
from napari_elsplus.processing.tracking.registration.pair_registration import PreparedFrame, Registrar

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.finished.field import FinishedField
    from napari_elsplus.processing.tracking.motion.pose import Pose
    from napari_elsplus.processing.tracking.registration.motion_models import MotionModel

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
_FLOOR_PX: Final = 0.01
"""Standard deviation of a displacement that no registration undercuts, pixels; chosen, as of raw frames."""
_MARGIN_PX: Final = 4.0
"""Margin of the high-passed images about the field, pixels of its diameter: the slopes at its edge need it."""
_AT_REST: Final = Velocity(0.0, 0.0)


@dataclass(slots=True)
class FinishedFrame:
    """A finished image, prepared.

    Parameters
    ----------
    index : int
        Number of the frame.
    view : PreparedFrame
        Binned as raw frames are, for the refinement.
    spectra : SpectraOfImage
        Of its logarithm, for the search.
    row, col : float
        Position in its segment, pixels of the images; nan where it has none.
    """

    index: int
    view: PreparedFrame
    spectra: SpectraOfImage
    row: float = nan
    col: float = nan


@dataclass(frozen=True, slots=True)
class FinishedLink:
    """An accepted registration.

    Parameters
    ----------
    edge : Edge
        Displacement of the probe from the earlier to the later frame, pixels of the images.
    score : float
        Correlation of the overlap.
    sigma : float
        Larger axis of the covariance, pixels.
    """

    edge: Edge
    score: float
    sigma: float


class FinishedRegistration:
    """Registers finished images of one field.

    Parameters
    ----------
    field : FinishedField
        Field of view and static pattern of the stack.
    """

    def __init__(self, field: FinishedField) -> None:
        self._field = field
        self._odds = ShiftOdds(field.mask, field.coarse_diameter)
        self.binning = max(1, round(FIELD * field.grid.diameter / REFINED_DIAMETER_PX))
        grid = _binned(field.grid, self.binning)
        self._registrar = Registrar(grid, FIELD + _MARGIN_PX / grid.diameter)

    @property
    def grid(self) -> Grid:
        """The grid of the binned images."""
        return self._registrar.grid

    def prepared(self, index: int, image: NDArray[np.float32]) -> FinishedFrame:
        """Return an image prepared for registration.

        Parameters
        ----------
        index : int
            Number of the frame.
        image : numpy.ndarray
            (side, side) float32 image on the field's grid.
        """
        view = self._registrar.view()
        side, used = len(view.image), len(view.image) * self.binning
        binned = cv2.resize(image[:used, :used], (side, side), interpolation=cv2.INTER_AREA)
        view.image[:] = cv2.sepFilter2D(binned, -1, _BINOMIAL, _BINOMIAL) if self.binning > 1 else binned
        spectra = self._odds.spectra(self._field.coarse_logarithm(image))
        return FinishedFrame(index, self._registrar.prepare(view), spectra)

    def register(self, earlier: FinishedFrame, later: FinishedFrame, more_odds: float = 0.0) -> FinishedLink | None:
        """Register two frames over all shifts; None where the odds are less than needed.

        Parameters
        ----------
        earlier, later : FinishedFrame
            Prepared frames.
        more_odds : float
            Odds that are needed besides, nats: the logarithm of the number of pairs that are tried.
        """
        found = self._odds.best(earlier.spectra, later.spectra)
        if found.odds < MIN_ODDS_NATS + more_odds:
            return None
        px = self._field.pixels_per_cell
        refined = self.refined(earlier, later, (-found.row * px, -found.col * px))
        if refined is not None:
            return FinishedLink(refined.edge, found.correlation, refined.sigma)
        sigma = _SEARCH_SIGMA_CELLS * px
        edge = Edge(earlier.index, later.index, (-found.row * px, -found.col * px), sigma**2 * np.eye(2))
        return FinishedLink(edge, found.correlation, sigma)

    def refined(
        self, earlier: FinishedFrame, later: FinishedFrame, displacement: tuple[float, float]
    ) -> FinishedLink | None:
        """Refine a displacement by Lucas-Kanade; None if that ends elsewhere, as where tissue deforms.

        Parameters
        ----------
        earlier, later : FinishedFrame
            Prepared frames.
        displacement : tuple of float
            Rows and columns by which the probe moved, pixels of the images.
        """
        q = self.binning
        moved = Displacement(displacement[0] / q, displacement[1] / q)
        motion = MotionPrior.between((_AT_REST, _AT_REST), moved, 0.0, 1.0, self.grid.shutter)
        fine = self._registrar.link(earlier.view, later.view, motion)
        row, col = -q * fine.warp.b, -q * fine.warp.d
        away_px = hypot(row - displacement[0], col - displacement[1])
        covariance = q**2 * fine.covariance + _FLOOR_PX**2 * np.eye(2)
        if fine.correlation <= 0 or not np.isfinite(covariance).all():
            return None
        if away_px > _REFINED_CELLS * self._field.pixels_per_cell:
            return None
        sigma = float(np.sqrt(np.linalg.eigvalsh(covariance)[-1]))
        return FinishedLink(Edge(earlier.index, later.index, (row, col), covariance), fine.correlation, sigma)


class FinishedNodes:
    """Registers nodes that are finished images; implements :class:`~.node_registration.NodeRegistration`.

    Parameters
    ----------
    registration : FinishedRegistration
        Registers two frames.
    frame : callable
        Returns the prepared frame of a node by its number.
    pairs : int
        Number of pairs of nodes that may be compared.
    """

    def __init__(self, registration: FinishedRegistration, frame: Callable[[int], FinishedFrame], pairs: int) -> None:
        self._registration, self._frame = registration, frame
        self._more_odds = log(max(pairs, 1))

    def beside(
        self, numbers: tuple[int, int], poses: tuple[Pose, Pose], views: tuple[PreparedFrame, PreparedFrame],
        expected: Displacement, turn: float, model: MotionModel,
    ) -> Edge | None:  # fmt: skip
        """Register two nodes: :meth:`NodeRegistration.beside`; neither velocity nor rotation is modelled."""
        return self._edge(numbers, 0.0)

    def anywhere(
        self, numbers: tuple[int, int], poses: tuple[Pose, Pose], views: tuple[PreparedFrame, PreparedFrame],
        expected: Displacement, turn: float, model: MotionModel,
    ) -> Edge | None:  # fmt: skip
        """Register two nodes of different segments, which needs more odds the more pairs there are.

        Parameters are those of :meth:`NodeRegistration.beside`.
        """
        return self._edge(numbers, self._more_odds)

    def _edge(self, numbers: tuple[int, int], more_odds: float) -> Edge | None:
        link = self._registration.register(self._frame(numbers[0]), self._frame(numbers[1]), more_odds)
        if link is None:
            return None
        q, (row, col) = self._registration.binning, link.edge.displacement
        return Edge(*numbers, (row / q, col / q), link.edge.covariance / q**2, sure=more_odds > 0)


def _binned(grid: Grid, binning: int) -> Grid:
    """Return a grid of coarser pixels; what is left over at its end is cut off."""
    row, col = ((c - (binning - 1) / 2) / binning for c in grid.centre)
    side = grid.side // binning // 4 * 4
    return Grid(side, binning, grid.origin, (row, col), grid.diameter / binning, grid.shutter)
