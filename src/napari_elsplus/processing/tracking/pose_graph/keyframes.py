"""Nodes along the track: the few frames by which it is remembered while the probe moves on."""

from __future__ import annotations

from math import hypot, isnan
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from napari_elsplus.processing.tracking.pose_graph.loop_closure import KEY_SPACING, LINK_STRETCH_PX, edge_covariance

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.front_end.grid import Grid
    from napari_elsplus.processing.tracking.motion.pose import Pose
    from napari_elsplus.processing.tracking.registration.pair_registration import PairRegistration

_DRIFT: Final = 0.001
"""Part of the path by which links may be off in one direction; rows per frame wrong by 3 % make it so much."""


class Node(NamedTuple):
    """A frame that is kept in mind.

    Parameters
    ----------
    frame : int
        Its number.
    pose : Pose
        Where the tracker has it.
    gone_px : float
        Path since the node before, pixels of the tracking grid.
    covariance : numpy.ndarray
        (2, 2) of its displacement from the node before, pixels squared.
    turn_sigma : float
        Of its angle against the node before; 1 where no rotation was asked for.
    upright : tuple of int and Pose, optional
        The tracked frame before, and where the tracker has it, if from this one on it models rotation: up to there it
        knew of no angle.
    """

    frame: int
    pose: Pose
    gone_px: float
    covariance: NDArray[np.float64]
    turn_sigma: float
    upright: tuple[int, Pose] | None = None


class KeyframeSelector:
    """Finds nodes, a quarter of a bundle diameter apart; costs next to nothing for the frames between them.

    Parameters
    ----------
    grid : Grid
        On which frames are tracked.
    """

    def __init__(self, grid: Grid) -> None:
        self._spacing_px = KEY_SPACING * grid.diameter
        self._shutter = grid.shutter
        self._stretch = LINK_STRETCH_PX / grid.shutter.line_periods_per_frame
        self._before: tuple[int, Pose] | None = None
        self._newest: tuple[int, int, PairRegistration] | None = None
        self._node: tuple[int, int, PairRegistration] | None = None
        self._gone = 0.0
        self._since: list[PairRegistration] = []

    def add(self, frame: int, pose: Pose, link: tuple[int, int, PairRegistration] | None) -> Node | None:
        """Take in a tracked frame; return it as a node if it is one, or the very first, once that is known to be one.

        Parameters
        ----------
        frame : int
            Its number.
        pose : Pose
            Where the tracker has it.
        link : tuple, optional
            How the tracker came to that: the earlier and the later frame, by its own count, and the link between them.
        """
        known, self._before = self._before, (frame, pose)
        before = None if known is None else known[1]
        if before is None or before.segment != pose.segment:
            if isnan(pose.score):
                return None  # the first of all: only the next one tells its velocity
            self._newest = self._node = link
            self._gone, self._since = 0.0, []
            return Node(frame, pose, 0.0, np.eye(2), 1.0)
        self._gone += hypot(pose.row - before.row, pose.col - before.col)
        if known is not None and link is not None and isnan(before.score):
            self._newest = link
            velocity, _ = self._shutter.velocities(link[2].warp)
            return Node(known[0], before._replace(velocity=velocity), 0.0, np.eye(2), 1.0)
        newest, self._newest = self._newest, link
        if link is not None and newest is not None and link[0] != newest[0]:
            self._since.append(newest[2])  # frames hang from a newer one now, which hangs by that
        noticed = pose.angle != 0 and before.angle == 0
        if self._gone < self._spacing_px and not noticed:
            return None
        node = Node(frame, pose, self._gone, *self._spread())
        if noticed:  # what the angles differ by is not what the probe turned by since
            node = node._replace(turn_sigma=1.0, upright=known)
        self._node, self._gone, self._since = link, 0.0, []
        return node

    def _spread(self) -> tuple[NDArray[np.float64], float]:
        """How far the newest frame may be off, seen from the node before: over the links between them."""
        links = [] if self._newest is None else [*self._since, self._newest[2]]
        if self._node is not None and links:
            if links[0] is not self._node[2]:  # both hang from the same frame
                links.append(self._node[2])
            elif len(links) > 1:
                links = links[1:]
        if not links:
            return np.eye(2), 1.0
        covariance = np.sum([edge_covariance(link, self._stretch) for link in links], axis=0)
        covariance += (_DRIFT * self._gone) ** 2 * np.eye(2)
        return covariance, min(1.0, hypot(*(link.turn_sigma for link in links)))
