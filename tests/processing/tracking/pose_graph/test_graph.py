"""Nodes, loops and corrections without threads: a tracker that drifts, on frames that know the truth."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from napari_elsplus.processing.tracking.front_end.front_end import FrontEnd
from napari_elsplus.processing.tracking.motion.pose import Pose, TrackingState
from napari_elsplus.processing.tracking.motion.rolling_shutter import Displacement, Velocity, Warp
from napari_elsplus.processing.tracking.pose_graph import graph as pose_graph
from napari_elsplus.processing.tracking.pose_graph.correction import Correction, Corrections
from napari_elsplus.processing.tracking.pose_graph.edge import Edge
from napari_elsplus.processing.tracking.pose_graph.graph import PoseGraph
from napari_elsplus.processing.tracking.pose_graph.nodes import KeyframeSelector, Node, NodeRegistration
from napari_elsplus.processing.tracking.registration.pair_registration import PairRegistration, Registrar, TrackedPair
from napari_elsplus.processing.tracking.tracker import Tracker
from recordings import Truth, record, texture

ROUND, SPEED = 50, 14.0
MOVED = Displacement(2.0, 0.0)
PLACED = Pose(0, 0.0, 0.0, Velocity(4.0, 0.0), 0.97, 0.1, TrackingState.TRACKED)
DRIFT = 0.002
"""Part of the path by which poses are spoilt, along the rows."""


@cache
def truth() -> Truth:
    """A probe that goes once round, and a little further."""
    t = 2 * np.pi * np.arange(ROUND + 12) / ROUND
    radius = SPEED * ROUND / (2 * np.pi)
    return record(texture(600, 8), 300 + radius * np.stack([np.sin(t), np.cos(t)], 1))


def spoilt(pose: Pose, frame: int) -> Pose:
    return pose._replace(row=pose.row + DRIFT * SPEED * frame)


@pytest.mark.parametrize("lifted", [False, True], ids=["one segment", "two segments"])
def test_nodes_that_see_a_place_again_tell_where_all_of_them_belong(lifted: bool) -> None:
    front_end = FrontEnd(truth().calibration, truth().frames.shape[1:])
    tracker, trail = Tracker(Registrar(front_end.grid)), KeyframeSelector(front_end.grid)
    registrar, views, images = Registrar(front_end.grid), {}, {}
    graph = PoseGraph(NodeRegistration(registrar), views.__getitem__)
    found: list[tuple[int, Pose]] = []
    recognised = 0
    for k, frame in enumerate(truth().frames):
        front_end.image(frame, tracker.slot())
        if lifted and 20 <= k < 30:
            tracker.slot()[:] = 0
        images[k] = tracker.slot().copy()
        pose = spoilt(tracker.add(), k)
        if pose.state is not TrackingState.TRACKED:
            continue
        found.append((k, pose))
        for node in trail.add(k, pose, tracker.links[-1] if tracker.links else None):
            views[node.frame] = view = registrar.view()
            view.image[:] = images[node.frame]
            registrar.prepare(view)
            graph.add(node)
            recognised += graph.unsolved
    assert len(graph.nodes) == len(views)
    assert len(views) < len(found) / 3
    assert recognised
    graph.solve()
    assert not graph.unsolved
    corrections = graph.corrections
    placed = [corrections.of(k, pose) for k, pose in found]
    assert {place.segment for place in placed} == {0}
    true = truth().positions[[k for k, _ in found]] / front_end.grid.binning
    errors = np.array([(place.row, place.col) for place in placed]) - (true - true[0])
    drifted = DRIFT * SPEED * len(truth().frames)
    assert (
        np.hypot(*errors.T).max() < (0.7 if lifted else 0.25) * drifted
    )  # within a lone segment nothing tells of drift
    whole = corrections.of_frames(
        np.array([k for k, _ in found]),
        np.array([pose.segment for _, pose in found]),
        *np.array([(pose.row, pose.col) for _, pose in found]).T,
    )
    np.testing.assert_allclose(np.stack(whole[1:3], 1), [(place.row, place.col) for place in placed])
    if not lifted:
        graph.remove(0)
        assert graph.corrections.of(*found[-1]) == found[-1][1]
        assert not graph.nodes


def test_a_long_live_track_keeps_few_nodes_and_the_newest_of_them_follow_a_loop(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(pose_graph, "MAX_NODES", 10)
    grid = FrontEnd(truth().calibration, truth().frames.shape[1:]).grid
    graph = PoseGraph(NodeRegistration(Registrar(grid)), lambda _: None)
    poses = [Pose(0, 60.0 * k, 0.0, Velocity(1.0, 0.0), 0.9, 0.1, TrackingState.TRACKED) for k in range(100)]
    for frame, pose in enumerate(poses):
        graph.add(Node(frame, pose, 60.0, np.eye(2), 1.0))
        graph.thin(lambda node: node.frame < 3)
        assert len(graph.nodes) <= 30
    frames = [node.frame for node in graph.nodes]
    assert frames[:3] == [0, 1, 2], "frames are kept of these, so that they can be registered"
    assert frames[-10:] == list(range(90, 100))
    last = len(frames) - 1
    graph._extend([Edge.between(0, last, poses[0], poses[-1].placed(poses[-1].at + 5, 0.0, 0))])
    graph._loops[0] = graph._loops[0]._replace(covariance=1e-2 * np.eye(2))
    graph.solve(10)
    moved = [place.row - pose.row for place, pose in ((graph.place(k), graph.nodes[k].pose) for k in range(last + 1))]
    np.testing.assert_array_equal(moved[:-10], 0.0)
    np.testing.assert_allclose(moved[-10:], np.arange(0.5, 5.1, 0.5), atol=0.1)


def test_a_correction_takes_a_turned_pose_to_its_place() -> None:
    pose = Pose(4, 100.0, -30.0, Velocity(1.0, 2.0), 0.9, 0.1, TrackingState.TRACKED, angle=0.1)
    place = pose._replace(segment=1, row=7.0, col=9.0, angle=0.35)
    there = Correction.between(pose, place).of(pose)
    assert there.segment == 1
    np.testing.assert_allclose([there.row, there.col, there.angle], [7.0, 9.0, 0.35])
    lost = pose._replace(row=np.nan, col=np.nan, state=TrackingState.LOST)
    assert np.isnan(Correction.between(pose, place).of(lost).row)


def test_segments_that_nothing_is_known_of_stay_where_they_are() -> None:
    pose = Pose(2, 1.0, 2.0, Velocity(0.0, 0.0), 0.9, 0.1, TrackingState.TRACKED)
    known = Corrections({0: [(5, Correction(0, 3.0))], 2: [(5, Correction(0, 3.0))]})
    assert known.of(9, pose).segment == 0
    assert known.without({2}).of(9, pose) == pose
    assert known.without({2}).newest(0) == known.newest(0)
    assert known.newest(7) == Correction(7)


def test_the_longer_the_way_between_two_nodes_the_less_it_is_trusted() -> None:
    grid = FrontEnd(truth().calibration, truth().frames.shape[1:]).grid
    tracker, trail = Tracker(Registrar(grid)), KeyframeSelector(grid)
    front_end = FrontEnd(truth().calibration, truth().frames.shape[1:])
    nodes: list[Node] = []
    for k, frame in enumerate(truth().frames):
        front_end.image(frame, tracker.slot())
        nodes += trail.add(k, tracker.add(), tracker.links[-1] if tracker.links else None)
    gone = np.array([node.gone_px for node in nodes[1:]])
    assert (gone >= 0.25 * grid.diameter).all()
    assert gone.max() < 0.25 * grid.diameter + 2 * SPEED
    sigma = np.sqrt([np.linalg.eigvalsh(node.covariance)[-1] for node in nodes[1:]])
    assert (sigma > 0.001 * gone).all()
    assert sigma.max() < 0.5


def test_nodes_are_joined_only_if_they_correlate_as_they_do_within_their_segments() -> None:
    """Before: they had no correlation to compare with, and two of 0.54 over a lattice joined places 388 px apart."""
    grid = FrontEnd(truth().calibration, truth().frames.shape[1:]).grid
    register, node = NodeRegistration(Registrar(grid)), Node(1, PLACED, 0.0, np.eye(2), 1.0)
    expected = Edge.between(0, 1, PLACED, PLACED)
    link = PairRegistration(Warp(1.0, 0.0, 0.0, 0.0), np.eye(4) * 1e4, PLACED.score, 0.9, 100.0)
    assert register.joins(link, (node, node), expected)
    assert not register.joins(link._replace(correlation=0.54), (node, node), expected)


def selected(halves: list[float], segments: list[int]) -> list[int]:
    """Return the frames that are nodes, of frames 4 px apart, from correlations at half resolution and segments."""
    trail, nodes = KeyframeSelector(FrontEnd(truth().calibration, truth().frames.shape[1:]).grid), []
    for frame, (half, segment) in enumerate(zip(halves, segments, strict=True)):
        pose = PLACED._replace(segment=segment, row=4.0 * frame, score=half)
        link = PairRegistration(Warp(1.0, -4.0, 0.0, 0.0), np.eye(4) * 1e4, half, 0.9, 100.0, at_half=half)
        registered = None if np.isnan(half) else TrackedPair(frame - 1, frame, Displacement(4.0, 0.0), link)
        nodes += trail.add(frame, pose, registered)
    return [node.frame for node in [*nodes, *trail.end()]]


def test_both_ends_of_a_short_segment_are_nodes_but_for_a_frame_that_is_registered_to_none() -> None:
    """Before: the first frame alone, so that segments stayed apart whose later frames overlap."""
    assert selected([np.nan, 0.9, 0.9, 0.9, np.nan, 0.9, 0.9], [0, 0, 0, 0, 1, 1, 1]) == [1, 3, 5, 6]


def test_a_frame_that_was_jolted_within_is_no_node() -> None:
    """Before: two segments were joined by such frames, and lay 5 px off."""
    assert selected([np.nan, 0.99, 0.99, 0.94, 0.95, 0.99, 0.99], [0, 0, 0, 0, 1, 1, 1]) == [1, 2, 5, 6]


def test_the_node_at_which_a_turn_was_noticed_does_not_say_how_far_the_probe_turned_since_the_one_before() -> None:
    grid = FrontEnd(truth().calibration, truth().frames.shape[1:]).grid
    trail = KeyframeSelector(grid)
    before = PairRegistration(Warp(1.0, -2.0, 0.0, 0.0), np.eye(4) * 1e4, 0.95, 0.9, 1.0)
    link = before._replace(turn=0.01, turn_sigma=1e-3)
    pose = Pose(1, 0.0, 0.0, Velocity(2.0, 0.0), 0.9, 0.1, TrackingState.TRACKED)
    assert len(trail.add(0, pose, TrackedPair(0, 1, MOVED, before))) == 1
    assert not trail.add(1, pose._replace(row=2.0), TrackedPair(1, 2, MOVED, before))
    (node,) = trail.add(2, pose._replace(row=4.0, angle=0.1), TrackedPair(2, 3, MOVED, link))
    assert node.upright == (1, pose._replace(row=2.0), 0.01)
    assert node.turn_sigma == 1.0
    assert not trail.add(3, pose._replace(row=6.0, angle=0.11), TrackedPair(3, 4, MOVED, link))
