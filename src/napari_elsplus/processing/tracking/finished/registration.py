"""Registration of two finished images: accepted by the odds of the shift, refined by Lucas-Kanade where it is rigid."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import hypot, inf, log
from typing import TYPE_CHECKING, Any, Final

import cv2
import numpy as np

from napari_elsplus.processing.tracking.finished.shift_odds import MIN_ODDS_NATS, ShiftOdds, SpectraOfImage
from napari_elsplus.processing.tracking.front_end.grid import FIELD, Grid
from napari_elsplus.processing.tracking.motion.motion_prior import MotionPrior
from napari_elsplus.processing.tracking.motion.prediction import AT_REST
from napari_elsplus.processing.tracking.motion.rolling_shutter import Displacement, Warp
from napari_elsplus.processing.tracking.pose_graph.least_squares import Edge
from napari_elsplus.processing.tracking.pose_graph.node_registration import edge_covariance
from napari_elsplus.processing.tracking.registration.pair_registration import PairRegistration, PreparedFrame, Registrar
from napari_elsplus.processing.tracking.registration.pyramid import Levels

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.finished.field import FinishedField
    from napari_elsplus.processing.tracking.motion.pose import Pose
    from napari_elsplus.processing.tracking.registration.motion_models import MotionModel

REFINED_DIAMETER_PX: Final = 240.0
"""Diameter to which fields are binned for the refinement, as raw frames are: finer than that, what is left of the cores
does not move with the tissue."""
RIGID_CORRELATION: Final = 0.95
"""Usual correlation from which keyframes serve many frames; chosen, deforming tissue stays below it."""
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


@dataclass(slots=True)
class FinishedFrame(PreparedFrame):
    """A finished image; its arrays are binned as raw frames are, for the refinement.

    Parameters
    ----------
    picture : numpy.ndarray
        (side, side) float32 image on the field's grid.
    spectra : SpectraOfImage, optional
        Of its logarithm, for the search, once needed.
    """

    picture: NDArray[np.float32] = field(kw_only=True)
    spectra: SpectraOfImage | None = None

    @property
    def image(self) -> NDArray[np.float32]:
        """The image on the field's grid."""
        return self.picture

    def renew(self) -> None:
        """Mark everything but the image as missing."""
        PreparedFrame.renew(self)
        self.spectra = None


class FinishedRegistrar(Registrar):
    """Registers finished images of one field over all shifts; they neither rotate nor have a rolling shutter.

    Implements :class:`~.node_registration.NodeRegistration`, too.

    Parameters
    ----------
    stack : FinishedField
        Field of view and static pattern of the stack.
    """

    max_sigma_px = fall_of_correlation = inf
    rigid_correlation = RIGID_CORRELATION

    def __init__(self, stack: FinishedField) -> None:
        self._field = stack
        self._odds = ShiftOdds(stack.mask, stack.coarse_diameter)
        self.binning = max(1, round(FIELD * stack.grid.diameter / REFINED_DIAMETER_PX))
        grid = _binned(stack.grid, self.binning)
        super().__init__(grid, FIELD + _MARGIN_PX / grid.diameter)

    def view(self) -> FinishedFrame:
        """See :meth:`~.Registrar.view`."""
        return FinishedFrame(Levels.of(self.grid.side), picture=np.zeros((self._field.grid.side,) * 2, np.float32))

    def prepare(self, view: PreparedFrame) -> PreparedFrame:
        """Fill the binned image, its coarser levels, and the spectra; see :meth:`~.Registrar.prepare`."""
        self._spectra_of(view)
        return view

    def _spectra_of(self, view: PreparedFrame) -> SpectraOfImage:
        """Return the spectra of a frame, which is prepared when they are first needed."""
        assert isinstance(view, FinishedFrame)
        if view.spectra is None:
            image = view.arrays.images[0]
            used = len(image) * self.binning
            binned = cv2.resize(view.picture[:used, :used], image.shape, interpolation=cv2.INTER_AREA)
            image[:] = cv2.sepFilter2D(binned, -1, _BINOMIAL, _BINOMIAL) if self.binning > 1 else binned
            super().prepare(view)
            view.spectra = self._odds.spectra(self._field.coarse_logarithm(view.picture))
        return view.spectra

    def link(
        self, earlier: PreparedFrame, later: PreparedFrame, motion: MotionPrior, min_correlation: float = 0.0
    ) -> PairRegistration:
        """Return a registration without odds: finished images are searched.

        Parameters
        ----------
        earlier, later, motion, min_correlation
            As of :meth:`~.Registrar.link`.
        """
        return PairRegistration(motion.warp, np.zeros((4, 4)), 0.0, 0.0)

    def search(
        self, earlier: PreparedFrame, later: PreparedFrame, motion: MotionPrior, reach_px: float,
        min_odds_nats: float = -inf, min_correlation: float = 0.0,
    ) -> PairRegistration | None:  # fmt: skip
        """Register two frames over all shifts; None where the odds are less than needed.

        Parameters
        ----------
        earlier, later : FinishedFrame
            Frames.
        motion, reach_px, min_odds_nats, min_correlation
            As of :meth:`~.Registrar.search`; only `min_odds_nats` is used.
        """
        found = self._odds.best(self._spectra_of(earlier), self._spectra_of(later))
        if found.odds < max(MIN_ODDS_NATS, min_odds_nats):
            return None
        cell_px = self._field.pixels_per_cell / self.binning
        shift = Warp(b=found.row * cell_px, d=found.col * cell_px)
        known = (_SEARCH_SIGMA_CELLS * cell_px) ** -2
        link = self._refined_shift(earlier, later, shift)
        if link is None:
            link = PairRegistration(shift, np.diag([_RIGID, known, _RIGID, known]), found.correlation, 1.0)
        return link._replace(correlation=found.correlation, odds=found.odds, velocity=AT_REST, velocity_variance=0.0)

    def remainder(self, *_: object, **__: object) -> None:
        """Return None: no rotation is tested for."""

    def _refined_shift(self, earlier: PreparedFrame, later: PreparedFrame, shift: Warp) -> PairRegistration | None:
        """Refine a shift by Lucas-Kanade; None if that ends elsewhere, as where tissue deforms."""
        there = Displacement(-shift.b, -shift.d)
        motion = MotionPrior.between((AT_REST, AT_REST), there, 0.0, 1.0, self.grid.shutter)
        fine = super().link(earlier, later, motion)
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
        motion = MotionPrior.between((AT_REST, AT_REST), expected, 0.0, 1.0, self.grid.shutter)
        more_odds = 2 * log(max(numbers)) if anywhere else 0.0
        found = self.search(*views, motion, inf, MIN_ODDS_NATS + more_odds)
        if found is None:
            return None
        displacement = -found.warp.b, -found.warp.d
        return Edge(*numbers, displacement, edge_covariance(found, 0.0), sure=anywhere)


def _binned(grid: Grid, binning: int) -> Grid:
    """Return a grid of coarser pixels; what is left over at its end is cut off."""
    row, col = ((c - (binning - 1) / 2) / binning for c in grid.centre)
    side = grid.side // binning // 4 * 4
    return Grid(side, binning, grid.origin, (row, col), grid.diameter / binning, grid.shutter)
