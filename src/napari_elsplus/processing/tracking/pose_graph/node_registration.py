"""Registration of two nodes of the pose graph, beside each other or at a place that was recognised."""

from __future__ import annotations

from math import hypot, isfinite
from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.processing.tracking.motion.motion_prior import MotionPrior
from napari_elsplus.processing.tracking.motion.rolling_shutter import Displacement
from napari_elsplus.processing.tracking.registration.motion_models import MotionModel
from napari_elsplus.processing.tracking.registration.pair_registration import Turn

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.motion.pose import Pose
    from napari_elsplus.processing.tracking.pose_graph.edge import Edge
    from napari_elsplus.processing.tracking.registration.pair_registration import (
        PairRegistration,
        PreparedFrame,
        Registrar,
    )

LINK_STRETCH_PX: Final = 0.2
"""Standard deviation of the velocity of a later frame that a tracker's registration leaves, pixels per frame period."""
MIN_JOIN_OVERLAP: Final = 0.2
"""Smallest overlap that joins segments, fraction of the disc; chosen: below it right shifts are seldom found."""
FALL_OF_CORRELATION: Final = 0.08
"""Largest fall of the correlation of frames of two segments below that of successive ones. Without it pairs of
different scenes are accepted in 2 of 20 sparse ones, with falls of 0.1 to 0.17."""
SURE_ODDS_NATS: Final = 48.0
"""Odds from which one edge joins segments; below it two edges without a common node must agree. Of frames of
different places the largest were 33, in 140 scenes of few fibres; of the same places the median is 80 and more."""
_VELOCITY_SIGMA: Final = 0.5
"""Standard deviation of the velocities of tracked frames, pixels per frame period; chosen, above that of a track."""
_SEARCHED_PX: Final = 16.0
"""Scale of the prior about the shift of two thumbnails, grid pixels: two of their cells."""
_FLOOR_PX: Final = 0.01
"""Standard deviation of a displacement that no registration undercuts, grid pixels: what the core pattern leaves."""


class NodeRegistration:
    """Registers two nodes of the pose graph.

    Parameters
    ----------
    registrar : Registrar
        Registers two frames; of this thread's own.

    Attributes
    ----------
    sure_odds_nats : float
        Odds from which one edge joins segments; below it two edges without a common node must agree.
    """

    sure_odds_nats = SURE_ODDS_NATS

    def __init__(self, registrar: Registrar) -> None:
        self.grid, self._registrar = registrar.grid, registrar

    def register(
        self, expected: Edge, poses: tuple[Pose, Pose], views: tuple[PreparedFrame, PreparedFrame], model: MotionModel,
        *, anywhere: bool,
    ) -> Edge | None:  # fmt: skip
        """Register two nodes; None where the frames do not determine their displacement.

        Parameters
        ----------
        expected : Edge
            Between the two, of which displacement and turn are used.
        poses : tuple of Pose
            Theirs, of which velocities and scores are used.
        views : tuple of PreparedFrame
            Their frames.
        model : MotionModel
            Model beside translations.
        anywhere : bool
            True to search over all shifts, for nodes of different segments.
        """
        shutter = self.grid.shutter
        there = Displacement(expected.displacement.real, expected.displacement.imag)
        velocities = poses[0].velocity, poses[1].velocity
        motion = MotionPrior.between(velocities, there, _VELOCITY_SIGMA, _SEARCHED_PX, shutter)
        turn = None if model is MotionModel.TRANSLATION else Turn(expected.turn)
        link = self._registrar.register(*views, motion, anywhere=anywhere, turn=turn)
        if link is None or not link.observed or (anywhere and not self.joins(link, poses, expected)):
            return None
        moved = shutter.displacement(link.warp, poses[1].velocity)
        return expected._replace(
            displacement=complex(*moved), turn=link.turn, turn_sigma=link.turn_sigma,
            covariance=edge_covariance(link, _VELOCITY_SIGMA / shutter.line_periods_per_frame),
            sure=link.odds > self.sure_odds_nats,
        )  # fmt: skip

    def joins(self, link: PairRegistration, poses: tuple[Pose, Pose], expected: Edge) -> bool:
        """Return True if frames of two segments overlap enough, and correlate about as well as successive ones.

        Parameters
        ----------
        link : PairRegistration
            Of the two.
        poses, expected
            As of :meth:`register`.
        """
        lowest = min((pose.score for pose in poses if isfinite(pose.score)), default=0.0)
        return link.overlap >= MIN_JOIN_OVERLAP and not link.correlation < lowest - FALL_OF_CORRELATION


def edge_covariance(link: PairRegistration, stretch_sigma: float) -> NDArray[np.float64]:
    """Return the covariance (2, 2) of a displacement: of the shift, of the later frame's velocity, and a floor.

    Parameters
    ----------
    link : PairRegistration
        Registration of the two frames.
    stretch_sigma : float
        Standard deviation of the stretch that the later velocity leaves open.
    """
    stretched = hypot(link.warp.b * stretch_sigma, _FLOOR_PX)
    return link.covariance + stretched**2 * np.eye(2)
