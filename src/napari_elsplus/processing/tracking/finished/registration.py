"""Registration of two finished images: accepted by the odds of the shift, refined by Lucas-Kanade where it is rigid."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import hypot, log, nan
from typing import TYPE_CHECKING, Any, Final

import cv2
import numpy as np

from napari_elsplus.processing.tracking.finished.shift_odds import MIN_ODDS_NATS, ShiftOdds, SpectraOfImage
from napari_elsplus.processing.tracking.front_end.grid import FIELD, Grid
from napari_elsplus.processing.tracking.motion.motion_prior import MotionPrior
from napari_elsplus.processing.tracking.motion.rolling_shutter import Displacement, Velocity, Warp
from napari_elsplus.processing.tracking.pose_graph.least_squares import Edge
from napari_elsplus.processing.tracking.pose_graph.node_registration import edge_covariance
from napari_elsplus.processing.tracking.registration.pair_registration import PairRegistration, PreparedFrame, Registrar

if TYPE_CHECKING:
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
_RIGID: Final = 1e12
"""Information on stretch and shear, of which images without a rolling shutter have none."""
_MARGIN_PX: Final = 4.0
"""Margin of the high-passed images about the field, pixels of its diameter: the slopes at its edge need it."""
_AT_REST: Final = Velocity(0.0, 0.0)


@dataclass(slots=True)
class FinishedFrame(PreparedFrame):
    """A finished image, binned as raw frames are for the refinement.

    Parameters
    ----------
    index : int
        Number of the frame.
    spectra : SpectraOfImage
        Of its logarithm, for the search.
    row, col : float
        Position in its segment, pixels of the binned image; nan where it has none.
    """

    index: int = field(kw_only=True)
    spectra: SpectraOfImage = field(kw_only=True)
    row: float = nan
    col: float = nan


class FinishedRegistration:
    """Registers finished images of one field; implements :class:`~.node_registration.NodeRegistration`.

    Parameters
    ----------
    stack : FinishedField
        Field of view and static pattern of the stack.
    """

    def __init__(self, stack: FinishedField) -> None:
        self._field = stack
        self._odds = ShiftOdds(stack.mask, stack.coarse_diameter)
        self.binning = max(1, round(FIELD * stack.grid.diameter / REFINED_DIAMETER_PX))
        grid = _binned(stack.grid, self.binning)
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
        self._registrar.prepare(view)
        spectra = self._odds.spectra(self._field.coarse_logarithm(image))
        return FinishedFrame(view.arrays, index=index, spectra=spectra)

    def link(self, earlier: FinishedFrame, later: FinishedFrame, more_odds: float = 0.0) -> PairRegistration | None:
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
        cell_px = self._field.pixels_per_cell / self.binning
        shift = Warp(b=found.row * cell_px, d=found.col * cell_px)
        refined = self.refined(earlier, later, shift)
        if refined is not None:
            return refined._replace(correlation=found.correlation)
        known = (_SEARCH_SIGMA_CELLS * cell_px) ** -2
        return PairRegistration(shift, np.diag([_RIGID, known, _RIGID, known]), found.correlation, 1.0, found.odds)

    def refined(self, earlier: FinishedFrame, later: FinishedFrame, shift: Warp) -> PairRegistration | None:
        """Refine a shift by Lucas-Kanade; None if that ends elsewhere, as where tissue deforms.

        Parameters
        ----------
        earlier, later : FinishedFrame
            Prepared frames.
        shift : Warp
            From the earlier to the later frame, pixels of the binned images.
        """
        motion = MotionPrior.between(
            (_AT_REST, _AT_REST), Displacement(-shift.b, -shift.d), 0.0, 1.0, self.grid.shutter
        )
        fine = self._registrar.link(earlier, later, motion)
        away_px = hypot(fine.warp.b - shift.b, fine.warp.d - shift.d) * self.binning
        if fine.correlation <= 0 or not np.isfinite(fine.covariance).all():
            return None
        return None if away_px > _REFINED_CELLS * self._field.pixels_per_cell else fine

    def register(
        self, numbers: tuple[int, int], poses: tuple[Pose, Pose], views: tuple[Any, Any], expected: Displacement,
        turn: float, model: MotionModel, *, anywhere: bool,
    ) -> Edge | None:  # fmt: skip
        """Register two nodes: :meth:`~.NodeRegistration.register`; neither velocity nor rotation is modelled.

        The more pairs of different segments there are, the more odds are needed.
        """
        found = self.link(*views, 2 * log(max(numbers)) if anywhere else 0.0)
        if found is None:
            return None
        displacement = -found.warp.b, -found.warp.d
        return Edge(*numbers, displacement, edge_covariance(found, 0.0), sure=anywhere)


def _binned(grid: Grid, binning: int) -> Grid:
    """Return a grid of coarser pixels; what is left over at its end is cut off."""
    row, col = ((c - (binning - 1) / 2) / binning for c in grid.centre)
    side = grid.side // binning // 4 * 4
    return Grid(side, binning, grid.origin, (row, col), grid.diameter / binning, grid.shutter)
