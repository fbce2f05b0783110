"""When the probe comes back: frames that show the same place again, linked across the time between.

Within a segment the track says where to look. Between segments nothing does: key frames of both are compared over all
shifts, and the segments are joined only if two pairs of frames, independently, say the same.
"""

from __future__ import annotations

from math import hypot
from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.processing.tracking.motion.pose import TrackingState
from napari_elsplus.processing.tracking.motion.rolling_shutter import Displacement, Velocity, Warp
from napari_elsplus.processing.tracking.pose_graph.least_squares import Edge
from napari_elsplus.processing.tracking.registration.low_texture import LowTextureFallback
from napari_elsplus.processing.tracking.registration.motion_models import MotionModel, turned_by
from napari_elsplus.processing.tracking.tracker import FALL_OF_CORRELATION

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from napari_elsplus.processing.tracking.motion.pose import Pose
    from napari_elsplus.processing.tracking.registration.pair_registration import (
        PairRegistration,
        PreparedFrame,
        Registrar,
    )

KEY_SPACING: Final = 0.25
"""Distance between key frames, in bundle diameters."""
REACH: Final = 0.45
"""Distance up to which key frames are linked, in bundle diameters."""
AWAY: Final = 1.0
"""Path between two frames, in bundle diameters, after which they close a loop."""
LINKS_PER_KEY: Final = 3
JOIN_OVERLAP: Final = 0.3
LINK_STRETCH_PX: Final = 0.2
"""What the velocity of the later frame of a tracker's link is trusted to, pixels per frame period."""
_VELOCITY_SIGMA: Final = 0.5
"""What the velocities of tracked frames are trusted to, pixels per frame period."""
_DRIFT: Final = 0.01
_AGREEMENT_PX: Final = 3.0
_AGREEMENT_RAD: Final = 0.02


def select_keyframes(poses: Sequence[Pose], spacing_px: float) -> list[int]:
    """Tracked frames of one segment, about so far apart along the path.

    Parameters
    ----------
    poses : sequence of Pose
        Of one segment.
    spacing_px : float
        Path between keyframes, pixels.
    """
    keys: list[int] = []
    gone = 0.0
    last: tuple[float, float] | None = None
    for index, pose in enumerate(poses):
        if pose.state is not TrackingState.TRACKED:
            continue
        gone += 0.0 if last is None else hypot(pose.row - last[0], pose.col - last[1])
        last = pose.row, pose.col
        if not keys or gone >= spacing_px:
            keys.append(index)
            gone = 0.0
    return keys


class LoopCloser:
    """Links frames that show the same place.

    Parameters
    ----------
    registrar : Registrar
        Registers two views.
    view : callable
        Returns the prepared view of a frame by its index.
    poses : sequence of Pose
        What the tracker made of every frame.
    rung : MotionModel
        What is modelled beside translations.
    """

    def __init__(
        self,
        registrar: Registrar,
        view: Callable[[int], PreparedFrame],
        poses: Sequence[Pose],
        rung: MotionModel = MotionModel.TRANSLATION,
    ) -> None:
        self.rung = rung
        self._scratch = registrar.view()
        self._registrar = registrar
        self._second = LowTextureFallback(registrar)
        self._view = view
        self._poses = poses
        scores = [pose.score for pose in poses if pose.state is TrackingState.TRACKED and np.isfinite(pose.score)]
        self._enough = (float(np.median(scores)) if scores else 1.0) - FALL_OF_CORRELATION

    def close(self, segment: int) -> list[Edge]:
        """Links between key frames of one segment that lie beside each other but far apart along the path."""
        diameter = self._registrar.grid.diameter
        poses = [p if p.segment == segment else p._replace(state=TrackingState.LOST) for p in self._poses]
        keys = select_keyframes(poses, KEY_SPACING * diameter)
        edges = []
        for n, later in enumerate(keys):
            here = poses[later]
            path = KEY_SPACING * diameter * np.arange(n, 0, -1)
            near = [
                (hypot(here.row - poses[k].row, here.col - poses[k].col), k, float(gone))
                for k, gone in zip(keys[:n], path, strict=True)
                if gone > AWAY * diameter
            ]
            for distance, earlier, gone in sorted(near)[:LINKS_PER_KEY]:
                if distance > REACH * diameter:
                    break
                edge = self.revisit(earlier, later, gone)
                if edge is not None:
                    edges.append(edge)
        return edges

    def join(self, earlier_segment: int, later_segment: int) -> list[Edge]:
        """Links between two segments; none unless two pairs of frames agree on how these lie.

        Parameters
        ----------
        earlier_segment, later_segment : int
            Segments of the track.
        """
        spacing = KEY_SPACING * self._registrar.grid.diameter
        before, after = (
            select_keyframes(
                [p if p.segment == s else p._replace(state=TrackingState.LOST) for p in self._poses], spacing
            )
            for s in (earlier_segment, later_segment)
        )
        bridge = Bridge()
        for later in after:
            for earlier in before:
                edge = self.recognise(earlier, later, before[-1], after[0])
                agreed = [] if edge is None else bridge.add(self.offset(edge), edge)
                if agreed:
                    return agreed
        return []

    def offset(self, edge: Edge) -> tuple[float, float, float]:
        """Where the later segment's origin lies in the earlier segment, and how it is turned there.

        Parameters
        ----------
        edge : Edge
            Between frames of two segments.
        """
        a, b = self._poses[edge.earlier], self._poses[edge.later]
        if self.rung is MotionModel.TRANSLATION:
            return a.row + edge.displacement[0] - b.row, a.col + edge.displacement[1] - b.col, 0.0
        angle, scale = a.angle + edge.turn, a.scale * edge.zoom
        row, col = turned_by(angle, scale) @ edge.displacement
        down, across = turned_by(angle - b.angle, scale / b.scale) @ (b.row, b.col)
        return a.row + float(row - down), a.col + float(col - across), angle - b.angle

    def revisit(self, earlier: int, later: int, path_px: float) -> Edge | None:
        """Register two frames of a segment, `path_px` apart along it, at their tracked places; None if rejected.

        Parameters
        ----------
        earlier, later : int
            Frames.
        path_px : float
            Path between them along the track, pixels.
        """
        a, b = self._poses[earlier], self._poses[later]
        expected = Displacement(b.row - a.row, b.col - a.col)
        if self.rung is not MotionModel.TRANSLATION:
            expected = Displacement(*(turned_by(-b.angle, 1 / b.scale) @ expected).tolist())
            edge = self._edge(earlier, later, self._turned(a, b, earlier, later, expected, b.angle - a.angle, None))
        else:
            warp = self._warp(a, b, expected)
            edge = self._edge(
                earlier, later, self._registrar.link(self._view(earlier), self._view(later), warp, self._spread)
            )
        if edge is None:
            return None
        miss = hypot(edge.displacement[0] - expected.row, edge.displacement[1] - expected.col)
        return edge if miss < _AGREEMENT_PX + _DRIFT * path_px else None

    def again(self, edge: Edge, turn: float) -> Edge | None:
        """Register two frames once more that were linked while no rotation was asked for; None if that says nothing.

        Parameters
        ----------
        edge : Edge
            What was said then.
        turn : float
            What they are thought to be turned by.
        """
        a, b = self._poses[edge.earlier], self._poses[edge.later]
        there = Displacement(*edge.displacement)
        found = self._edge(edge.earlier, edge.later, self._turned(a, b, edge.earlier, edge.later, there, turn, None))
        if found is None:
            return None
        miss = hypot(found.displacement[0] - there.row, found.displacement[1] - there.col)
        return found if miss < _AGREEMENT_PX + abs(found.turn) * hypot(*there) else None

    def recognise(self, earlier: int, later: int, before: int, after: int) -> Edge | None:
        """Compare two frames over all shifts; `before` and `after` are the frames around the gap, turned alike.

        Parameters
        ----------
        earlier, later : int
            Frames of two segments.
        before, after : int
            Last frame of the earlier segment, and first one of the later segment.
        """
        a, b = self._poses[earlier], self._poses[later]
        reach = REACH * self._registrar.grid.diameter
        link: PairRegistration | None
        if self.rung is not MotionModel.TRANSLATION:
            turn = b.angle - self._poses[after].angle + self._poses[before].angle - a.angle
            link = self._turned(a, b, earlier, later, Displacement(0.0, 0.0), turn, reach)
        else:
            warp = self._warp(a, b, Displacement(0.0, 0.0))
            link = self._registrar.search(self._view(earlier), self._view(later), warp, self._spread, reach)
        return None if link is None or link.overlap < JOIN_OVERLAP else self._edge(earlier, later, link)

    def _turned(
        self, a: Pose, b: Pose, earlier: int, later: int, expected: Displacement, turn: float, reach: float | None
    ) -> PairRegistration | None:
        return self._registrar.turned_link(
            self._view(earlier), self._view(later), (*expected, turn, b.scale / a.scale), (a.velocity, b.velocity),
            self._spread, self.rung, self._scratch, reach,
        )  # fmt: skip

    def _edge(self, earlier: int, later: int, link: PairRegistration | None) -> Edge | None:
        if link is not None:
            velocities = self._poses[earlier].velocity, self._poses[later].velocity
            views = self._view(earlier), self._view(later)
            link = self._second.confirmed(link, *views, velocities, _VELOCITY_SIGMA, self._scratch)
        if link is None or not link.observed or link.correlation < self._enough:
            return None
        moved = self._registrar.grid.shutter.displacement(link.warp, self._poses[later].velocity)
        covariance = edge_covariance(link, self._spread[0])
        return Edge(earlier, later, (moved.row, moved.col), covariance, link.turn, link.zoom, link.turn_sigma)

    def _warp(self, a: Pose, b: Pose, displacement: Displacement) -> Warp:
        return self._registrar.grid.shutter.warp(Velocity(*a.velocity), Velocity(*b.velocity), displacement)

    @property
    def _spread(self) -> tuple[float, float]:
        return (_VELOCITY_SIGMA / self._registrar.grid.shutter.line_periods_per_frame + 1e-9,) * 2


class Bridge:
    """Pairs of frames that each say how two segments lie; the segments are joined once two of them agree."""

    def __init__(self) -> None:
        self._found: list[tuple[tuple[float, float, float], Edge]] = []

    def add(self, offset: tuple[float, float, float], edge: Edge) -> list[Edge]:
        """Take in a link between the segments; return those that agree once two have no frame in common, else none.

        Parameters
        ----------
        offset : tuple of float
            From :meth:`LoopCloser.offset`: row, col (pixels) and angle (radians).
        edge : Edge
            Between frames of the two segments.
        """
        partners = [e for o, e in self._found if _agree(o, offset)]
        self._found.append((offset, edge))
        independent = any(e.later != edge.later and e.earlier != edge.earlier for e in partners)
        return [*partners, edge] if independent else []


def _agree(one: tuple[float, float, float], other: tuple[float, float, float]) -> bool:
    near = hypot(one[0] - other[0], one[1] - other[1]) < _AGREEMENT_PX
    return near and abs(one[2] - other[2]) < _AGREEMENT_RAD


def edge_covariance(link: PairRegistration, stretch_sigma: float) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Covariance of a displacement: the shift's own, what the later frame's velocity adds, and a floor.

    Parameters
    ----------
    link : PairRegistration
        Registration of the two frames.
    stretch_sigma : float
        Standard deviation of the stretch that the later velocity leaves open.
    """
    shift = link.warp.b**2 * stretch_sigma**2
    return link.covariance + (shift + 1e-4) * np.eye(2)
