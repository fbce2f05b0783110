"""Segments are joined by the places that they share, however short they are, and by no others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from napari_elsplus.processing.tracking.front_end.front_end import FrontEnd
from napari_elsplus.processing.tracking.motion.pose import Pose, TrackingState
from napari_elsplus.processing.tracking.motion.rolling_shutter import Velocity
from napari_elsplus.processing.tracking.pose_graph.graph import PoseGraph
from napari_elsplus.processing.tracking.pose_graph.nodes import Node, NodeRegistration
from napari_elsplus.processing.tracking.pose_graph.place_recognition import PlaceRecognition
from napari_elsplus.processing.tracking.registration.motion_models import MotionModel, turned_by
from napari_elsplus.processing.tracking.registration.pair_registration import PreparedFrame, Registrar
from napari_elsplus.simulation.specimen.trajectories import Spiral, Turning
from recordings import Truth, fibres, record, texture
from simulated import followed


def seen_at(scene: np.ndarray, places: list[tuple[float, float]], speed: tuple[float, float] = (9.0, 14.0)) -> Truth:
    """Return frames of a probe that jumps between places, camera pixels, and moves evenly within each frame."""
    starts = np.concatenate([np.add(place, [(0, 0), speed]) for place in places])
    truth = record(scene, starts)  # the odd frames are the jumps
    return replace(truth, frames=truth.frames[::2], positions=truth.positions[::2], starts=starts)


def segments_of_one(
    truths: list[Truth], speed: tuple[float, float] = (9.0, 14.0), model: MotionModel = MotionModel.TRANSLATION,
    jolted: dict[int, tuple[float, float]] | None = None,
) -> tuple[PoseGraph, np.ndarray]:  # fmt: skip
    """Return a graph of one segment for each frame, and the true positions, grid pixels.

    The velocities of nodes that are `jolted` are off by some pixels per frame period, and as uncertain.
    """
    front_end = FrontEnd(truths[0].calibration, truths[0].frames.shape[1:])
    registrar = Registrar(front_end.grid)
    views: list[PreparedFrame] = []
    graph = PoseGraph(NodeRegistration(registrar), lambda number: views[number])
    velocity = Velocity(*np.divide(speed, front_end.grid.binning))
    for number, frame in enumerate(np.concatenate([truth.frames for truth in truths])):
        view = registrar.view()
        front_end.image(frame, view.image)
        views.append(registrar.prepare(view))
        wrong = (jolted or {}).get(number, (0.0, 0.0))
        tracked = Velocity(*np.add(velocity, wrong))
        pose = Pose(number, 0.0, 0.0, tracked, 0.97, 0.1, TrackingState.TRACKED)
        graph.add(Node(number, pose, 0.0, np.eye(2), 1.0, velocity_sigma=0.5 + np.hypot(*wrong)), model)
    graph.solve()
    return graph, np.concatenate([truth.positions for truth in truths]) / front_end.grid.binning


def places_of(graph: PoseGraph) -> list[Pose]:
    return [graph.place(number) for number in range(len(graph.nodes))]


def test_segments_of_one_frame_that_overlap_are_joined() -> None:
    places = [(200.0, 200.0), (400.0, 420.0), (280.0, 230.0), (350.0, 320.0)]  # the last one connects the others
    graph, true = segments_of_one([seen_at(texture(700, 8), places)])
    assert [place.segment for place in places_of(graph)] == [0, 0, 0, 0]
    found = np.array([(place.row, place.col) for place in places_of(graph)])
    np.testing.assert_allclose(found, true - true[0], atol=0.15)


@pytest.mark.parametrize("node", [0, 1], ids=["the earlier", "the later"])
def test_a_node_of_uncertain_velocity_is_joined_where_it_belongs(node: int) -> None:
    """Before, it was off by the velocity's error times the part of a frame period by which rows are displaced."""
    seen = seen_at(texture(700, 8), [(200.0, 200.0), (310.0, 240.0)])
    graph, true = segments_of_one([seen], jolted={node: (-8.0, 7.0)})
    first, second = places_of(graph)
    assert second.segment == 0
    assert abs(second.at - first.at - complex(*(true[1] - true[0]))) < 0.3


def joined(scenes: list[np.ndarray], seed: int, model: MotionModel = MotionModel.TRANSLATION) -> int:
    """Return how many segments join frames of different scenes."""
    rng = np.random.default_rng(seed)
    truths = [seen_at(scene, list(map(tuple, rng.uniform(200, 400, (2, 2))))) for scene in scenes]
    graph, _ = segments_of_one(truths, model=model)
    scene = np.repeat(np.arange(len(scenes)), 2)
    segment = np.array([place.segment for place in places_of(graph)])
    return sum(len(set(scene[segment == one])) > 1 for one in set(segment))


def test_different_places_are_not_joined() -> None:
    assert joined([texture(600, seed) for seed in (31, 32)] + [fibres(600, 12, seed) for seed in (33, 34)], 1) == 0


@pytest.mark.slow
@pytest.mark.parametrize("count", [6, 12, 60])
def test_no_false_join_among_twenty_scenes_of_fibres(count: int) -> None:
    assert joined([fibres(600, count, seed) for seed in range(100, 120)], 2) == 0


@pytest.mark.slow
def test_a_view_of_one_fibre_that_resembles_another_once_it_is_turned_joins_nothing_alone() -> None:
    assert joined([fibres(600, 12, seed) for seed in range(200, 220)], 200, MotionModel.RIGID) == 0


def test_segments_between_which_the_probe_turned_are_joined() -> None:
    """By 8 degrees while it was lost, of which a thumbnail tolerates half."""
    path = Turning(Spiral(6000.0), 200.0)
    seen = followed(path, "fibres", 64, dark=slice(40, 49))
    poses, angle = seen.pipeline.poses, path.angles_rad(seen.times_s)
    tracked = np.array([pose.state is TrackingState.TRACKED for pose in poses])
    assert {poses[k].segment for k in np.flatnonzero(tracked)} == {0}
    assert tracked.sum() >= 54
    turned = np.array([pose.angle for pose in poses])
    assert np.abs(np.rad2deg(turned - angle + angle[0]))[tracked].max() < 0.3
    moved = (seen.positions_px - seen.positions_px[0]) @ turned_by(float(-angle[0])).T
    assert np.abs(seen.found_px - moved)[tracked].max() < 1.5


def test_a_thumbnail_finds_its_place_among_others_in_spite_of_motion() -> None:
    scene = texture(900, 5)
    rng = np.random.default_rng(4)
    places = [tuple(rng.uniform(200, 700, 2)) for _ in range(30)]
    there = seen_at(scene, places, (0.0, 0.0))
    again = seen_at(scene, [tuple(np.add(places[7], (60.0, -30.0)))], (30.0, -25.0))
    front_end = FrontEnd(there.calibration, there.frames.shape[1:])
    registrar = Registrar(front_end.grid)
    recognition, view = PlaceRecognition(front_end.grid), registrar.view()

    def thumbnail(frame: np.ndarray, velocity: tuple[float, float]):
        front_end.image(frame, view.image)
        return recognition.thumbnail(registrar.prepare(view), Velocity(*velocity), 0.0)

    others = {number: thumbnail(frame, (0.0, 0.0)) for number, frame in enumerate(there.frames)}
    best = recognition.candidates({0.0: thumbnail(again.frames[0], (30.0, -25.0))}, others, 3)[0]
    assert best.odds > 5
    assert abs(best.displacement - complex(*(again.positions[0] - there.positions[best.node]))) < 12
