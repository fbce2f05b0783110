"""Registration of two finished images: accepted by the odds of the shift, refined by Lucas-Kanade where it is rigid."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import hypot, inf, log
from typing import TYPE_CHECKING, Any, Final

import cv2
import numpy as np

from napari_elsplus.processing.tracking.finished.shift_odds import MIN_ODDS_NATS, ShiftOdds
from napari_elsplus.processing.tracking.front_end.grid import FIELD
from napari_elsplus.processing.tracking.motion.motion_prior import MotionPrior
from napari_elsplus.processing.tracking.motion.prediction import AT_REST
from napari_elsplus.processing.tracking.motion.rolling_shutter import Displacement, Warp
from napari_elsplus.processing.tracking.pose_graph.nodes import NodeRegistration
from napari_elsplus.processing.tracking.registration.pair_registration import PairRegistration, PreparedFrame, Registrar
from napari_elsplus.processing.tracking.registration.pyramid import Levels

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.finished.field import FinishedField
    from napari_elsplus.processing.tracking.pose_graph.edge import Edge
    from napari_elsplus.processing.tracking.pose_graph.nodes import Node

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
    """

    picture: NDArray[np.float32] = field(kw_only=True)

    @property
    def image(self) -> NDArray[np.float32]:
        """The image on the field's grid."""
        return self.picture


class FinishedRegistrar(Registrar):
    """Registers finished images of one field over all shifts; they neither rotate nor have a rolling shutter.

    Parameters
    ----------
    stack : FinishedField
        Field of view and static pattern of the stack.
    """

    max_sigma_px = fall_of_correlation = inf
    rigid_correlation, registers_warps = RIGID_CORRELATION, False

    def __init__(self, stack: FinishedField) -> None:
        self._field = stack
        self._odds = ShiftOdds(stack.mask, stack.coarse_diameter)
        self.binning = max(1, round(FIELD * stack.grid.diameter / REFINED_DIAMETER_PX))
        grid = stack.grid.binned(self.binning)
        grid = replace(grid, side=grid.side // 4 * 4)
        super().__init__(grid, FIELD + _MARGIN_PX / grid.diameter)

    def view(self) -> FinishedFrame:
        """See :meth:`~.Registrar.view`."""
        return FinishedFrame(Levels.of(self.grid.side), picture=np.zeros((self._field.grid.side,) * 2, np.float32))

    def prepare(self, view: PreparedFrame) -> PreparedFrame:
        """Fill the binned image, its coarser levels, and the spectra of its logarithm: :meth:`~.Registrar.prepare`."""
        image = view.arrays.images[0]
        used = len(image) * self.binning
        even = view.image / self._field.light
        binned = cv2.resize(even[:used, :used], image.shape, interpolation=cv2.INTER_AREA)
        image[:] = cv2.sepFilter2D(binned, -1, _BINOMIAL, _BINOMIAL) if self.binning > 1 else binned
        super().prepare(view)
        view.coarse = self._odds.spectra(self._field.coarse_logarithm(even))
        return view

    def register(
        self, earlier: PreparedFrame, later: PreparedFrame, motion: MotionPrior, *_: Any, **__: Any
    ) -> PairRegistration | None:
        """Register two frames over all shifts; None where the odds are less than needed.

        Parameters
        ----------
        earlier, later : FinishedFrame
            Frames.
        motion
            Not used.
        """
        for view in (earlier, later):
            if view.coarse is None:
                self.prepare(view)
        found = self._odds.best(earlier.coarse, later.coarse)
        if found.odds < MIN_ODDS_NATS:
            return None
        cell_px = self._field.pixels_per_cell / self.binning
        shift = Warp(b=found.row * cell_px, d=found.col * cell_px)
        known = (_SEARCH_SIGMA_CELLS * cell_px) ** -2
        searched = PairRegistration(shift, np.diag([_RIGID, known, _RIGID, known]), found.correlation, 1.0)
        there = Displacement(-shift.b, -shift.d)
        motion = MotionPrior.between((AT_REST, AT_REST), there, (0.0, 0.0), 1.0, self.grid.shutter)
        fine = self._refined(earlier, later, motion)  # where tissue deforms it may end elsewhere
        near = hypot(fine.warp.b - shift.b, fine.warp.d - shift.d) <= _REFINED_CELLS * cell_px
        link = fine if near and fine.correlation > 0 and np.isfinite(fine.covariance).all() else searched
        link = link._replace(correlation=found.correlation, at_half=found.correlation, odds=found.odds)
        return link._replace(velocity=AT_REST, velocity_variance=0.0)


class FinishedNodeRegistration(NodeRegistration):
    """Registers nodes that are finished images; neither velocity nor rotation is modelled."""

    sure_odds_nats, noise_share = 0.0, 1.0

    def joins(self, link: PairRegistration, nodes: tuple[Node, Node], expected: Edge) -> bool:
        """Return True if the odds suffice: the more pairs of different segments there are, the more are needed.

        Parameters
        ----------
        link, nodes, expected
            As of :meth:`~.NodeRegistration.joins`.
        """
        return link.odds >= MIN_ODDS_NATS + 2 * log(max(expected.earlier, expected.later))
