"""Nodes of the pose graph: selected from the track, and registered beside each other or at a recognised place."""

from __future__ import annotations

from math import hypot, inf, isfinite, isnan, nan
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from napari_elsplus.processing.tracking.motion.motion_prior import MotionPrior
from napari_elsplus.processing.tracking.motion.rolling_shutter import Displacement
from napari_elsplus.processing.tracking.registration.motion_models import MotionModel
from napari_elsplus.processing.tracking.registration.odds import CORRELATED_PX
from napari_elsplus.processing.tracking.registration.pair_registration import Turn

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.front_end.grid import Grid
    from napari_elsplus.processing.tracking.motion.pose import Pose
    from napari_elsplus.processing.tracking.pose_graph.edge import Edge
    from napari_elsplus.processing.tracking.registration.pair_registration import (
        PairRegistration,
        PreparedFrame,
        Registrar,
        TrackedPair,
    )

KEY_SPACING: Final = 0.25
"""Path between two nodes, bundle diameters; chosen: neighbours share 0.7 of the field."""
_DRIFT: Final = 0.001
"""Systematic error of registrations, fraction of the path; derived: that of line periods per frame off by 3 %."""
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
"""Smallest standard deviation of the velocity of a node, pixels per frame period; chosen, above that of a track."""
_SEARCHED_PX: Final = 16.0
"""Scale of the prior about the shift of two thumbnails, grid pixels: two of their cells."""
FLOOR_PX: Final = 0.01
"""Standard deviation of a displacement that no registration undercuts, grid pixels: what the core pattern leaves."""
JOLTED_FALL: Final = 0.02
"""Correlation at half resolution below the recent mean from which a frame was jolted within, so that its middle is
unknown; chosen: such frames correlate by 0.045 and more less in rich tissue, others by up to 0.01."""
_MEMORY: Final = 0.2
"""Part by which a frame's correlation changes that mean."""
SMOOTHED_PX: Final = (256 / 70) ** 2
"""Pixels that share one value of the noise; derived: the front end smooths by 1 4 6 4 1 along rows and columns."""


class Node(NamedTuple):
    """A frame in the pose graph.

    Parameters
    ----------
    frame : int
        Its number.
    pose : Pose
        As tracked.
    gone_px : float
        Path since the node before, pixels of the tracking grid.
    covariance : numpy.ndarray
        (2, 2) of its displacement from the node before, pixels squared.
    turn_sigma : float
        Standard deviation of its angle against the node before, radians; 1 where no rotation was modelled.
    velocity_sigma : float
        Standard deviation of its velocity, pixels per frame period: more after a jolt.
    upright : tuple of int, Pose and float, optional
        The tracked frame before, its pose, and the turn since, radians, if rotation is modelled from this node on: up
        to there no angle is known.
    """

    frame: int
    pose: Pose
    gone_px: float
    covariance: NDArray[np.float64]
    turn_sigma: float
    velocity_sigma: float = _VELOCITY_SIGMA
    upright: tuple[int, Pose, float] | None = None


class KeyframeSelector:
    """Selects nodes a quarter of a bundle diameter apart, and the ends of segments, from frames without a jolt within.

    Parameters
    ----------
    grid : Grid
        Tracking grid.
    """

    def __init__(self, grid: Grid) -> None:
        self._spacing_px = KEY_SPACING * grid.diameter
        self._stretch = LINK_STRETCH_PX / grid.shutter.line_periods_per_frame
        self._before: tuple[int, Pose] | None = None
        self._newest: TrackedPair | None = None
        self._gone, self._unknown = 0.0, False
        self._since: list[PairRegistration] = []
        self._end: tuple[int, Pose, float, TrackedPair | None] | None = None
        self._usual, self._fall = nan, JOLTED_FALL if isfinite(grid.shutter.line_periods_per_frame) else inf

    def add(self, frame: int, pose: Pose, link: TrackedPair | None) -> list[Node]:
        """Return the nodes that a tracked frame adds: itself, an end of its segment, that of the one before, or none.

        Parameters
        ----------
        frame : int
            Its number.
        pose : Pose
            As tracked.
        link : TrackedPair, optional
            Registration of which the pose follows, frames by the tracker's count.
        """
        known, usual = self._before, self._usual
        half = usual if link is None else link.registration.at_half
        jolted = half < usual - self._fall
        self._usual = half if isnan(usual) else usual + _MEMORY * (half - usual)
        if known is None or known[1].segment != pose.segment:
            begins = not (jolted or isnan(pose.score))
            nodes, self._before = self.end(), (frame, pose) if begins else None
            self._newest = link
            self._gone, self._since, self._unknown, self._end = 0.0, [], False, None
            return [*nodes, Node(frame, pose, 0.0, np.eye(2), 1.0, _velocity_sigma(link))] if begins else nodes
        self._before = frame, pose
        newest = self._newest
        self._unknown |= link is None
        self._gone += abs(pose.at - known[1].at)
        self._newest, begins_to_turn = link, False
        if link is not None and newest is not None:
            if link.earlier != newest.earlier:  # frames are registered to a newer one now, which was registered by that
                self._since.append(newest.registration)
            begins_to_turn = link.registration.turn_sigma < newest.registration.turn_sigma == inf
        if not jolted:
            self._end = frame, pose, self._gone, link
        if (jolted or self._gone < self._spacing_px) and not begins_to_turn:
            return []
        node = Node(frame, pose, self._gone, *self._spread(), _velocity_sigma(link))
        if begins_to_turn and link is not None:  # the angle that was added is not what the probe turned by since
            turn = link.registration.turn * (frame - known[0]) / (link.later - link.earlier)
            node = node._replace(turn_sigma=1.0, upright=(*known, turn))
        self._gone, self._since, self._unknown, self._end = 0.0, [], False, None
        return [node]

    def end(self) -> list[Node]:
        """Return the newest frame as a node if it is none yet: in a short segment it shows what no other node does."""
        if self._end is None:
            return []
        frame, pose, gone, link = self._end
        return [Node(frame, pose, gone, *self._spread(), _velocity_sigma(link))]

    def _spread(self) -> tuple[NDArray[np.float64], float]:
        """Return the covariance of the newest frame's displacement from the node before, and its angle's deviation."""
        links = [] if self._newest is None or self._unknown else [*self._since, self._newest.registration]
        if not links:
            return np.eye(2), 1.0
        covariance = np.sum([edge_covariance(link, self._stretch) for link in links], axis=0)
        covariance += (_DRIFT * self._gone) ** 2 * np.eye(2)
        return covariance, min(1.0, hypot(*(link.turn_sigma for link in links)))


def _velocity_sigma(link: TrackedPair | None) -> float:
    """Return the standard deviation of the velocity of a frame, given its registration, pixels per frame period."""
    return max(_VELOCITY_SIGMA, 0.0 if link is None else link.registration.velocity_variance**0.5)


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
    noise_share : float
        Variance of a finished position by noise over the covariance of its registration, by which that is accepted.
    """

    sure_odds_nats, noise_share = SURE_ODDS_NATS, SMOOTHED_PX / CORRELATED_PX

    def __init__(self, registrar: Registrar) -> None:
        self.grid, self._registrar = registrar.grid, registrar

    def register(
        self, expected: Edge, nodes: tuple[Node, Node], views: tuple[PreparedFrame, PreparedFrame], model: MotionModel,
        *, anywhere: bool,
    ) -> Edge | None:  # fmt: skip
        """Register two nodes; None where the frames do not determine their displacement.

        Parameters
        ----------
        expected : Edge
            Between the two, of which displacement and turn are used.
        nodes : tuple of Node
            The two, of which velocities and scores are used.
        views : tuple of PreparedFrame
            Their frames.
        model : MotionModel
            Model beside translations.
        anywhere : bool
            True to search over all shifts, for nodes of different segments.
        """
        shutter = self.grid.shutter
        there = Displacement(expected.displacement.real, expected.displacement.imag)
        velocities = nodes[0].pose.velocity, nodes[1].pose.velocity
        sigmas = nodes[0].velocity_sigma, nodes[1].velocity_sigma
        motion = MotionPrior.between(velocities, there, sigmas, _SEARCHED_PX, shutter)
        turn = None if model is MotionModel.TRANSLATION else Turn(expected.turn)
        link = self._registrar.register(*views, motion, anywhere=anywhere, turn=turn)
        if link is None or not link.observed or (anywhere and not self.joins(link, nodes, expected)):
            return None
        moved = shutter.displacement(link.warp, link.velocity)
        return expected._replace(
            displacement=complex(*moved), turn=link.turn, turn_sigma=link.turn_sigma,
            covariance=edge_covariance(link, link.velocity_variance**0.5 / shutter.line_periods_per_frame),
            sure=link.odds > self.sure_odds_nats,
        )  # fmt: skip

    def joins(self, link: PairRegistration, nodes: tuple[Node, Node], expected: Edge) -> bool:
        """Return True if frames of two segments overlap enough, and correlate about as well as successive ones.

        Parameters
        ----------
        link : PairRegistration
            Of the two.
        nodes, expected
            As of :meth:`register`.
        """
        lowest = min((node.pose.score for node in nodes if isfinite(node.pose.score)), default=0.0)
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
    stretched = hypot(link.warp.b * stretch_sigma, FLOOR_PX)
    return link.covariance + stretched**2 * np.eye(2)
