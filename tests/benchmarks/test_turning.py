from __future__ import annotations

import pytest

from benchmarks.parsimony.turning import Walk, follow, recorded
from benchmarks.rigs.simulated import simulated_rig
from napari_elsplus.processing.tracking.registration.motion_models import MotionModel
from napari_elsplus.workflows.tracking import Pipeline

WAYS = (("fibres", "hand", 1500.0), ("nuclei", "spiral", 8000.0), ("sparse", "hand", 3000.0), ("fibres", "still", 0.0))


def test_a_turn_is_modelled_soon_and_finished_well() -> None:
    found = follow(Walk("fibres", "hand", 2000.0, 40.0, 50))
    assert found.model is MotionModel.RIGID
    assert found.since is not None
    assert found.since < 20
    assert found.angle_error_deg < 0.1 < found.angle_deg
    assert found.errors.wrong_links == 0
    assert found.errors.tracked == 50


def test_half_a_second_of_slow_turning_shows_in_a_sparse_scene() -> None:
    """At the end at the latest; taken for translations it would be one pixel off from frame to frame."""
    found = follow(Walk("sparse", "spiral", 8000.0, 10.0, 120, seed=2))
    assert found.model is MotionModel.RIGID
    assert found.angle_error_deg < 0.5
    assert found.errors.median_pair_error_px < 0.3
    assert found.errors.wrong_links == 0


def test_a_turn_that_is_noticed_late_is_told_to_what_was_linked_before_live_as_in_a_recording() -> None:
    found = follow(Walk("nuclei", "spiral", 8000.0, 2.0, 150))
    assert found.since is not None
    assert found.since > 75
    alone, live, finished = found.strayed_px
    assert alone > 4
    assert live < finished + 0.5 < 2


def test_views_with_two_fibres_do_not_pretend_that_the_probe_turns() -> None:
    assert _model_of(Walk("sparse", "spiral", 8000.0, 0.0, 40, seed=1)) is MotionModel.TRANSLATION


@pytest.mark.parametrize("seed", [3, 4])
def test_where_a_turn_and_a_shift_look_alike_the_turn_goes_on_as_it_was(seed: int) -> None:
    assert follow(Walk("sparse", "spiral", 8000.0, 50.0, 120, seed)).errors.wrong_links == 0


@pytest.mark.slow
def test_99_of_100_recordings_without_a_turn_are_tracked_by_translations() -> None:
    walks = [Walk(*way, 0.0, 60, seed) for seed in range(25) for way in WAYS]
    assert [_model_of(walk) for walk in walks].count(MotionModel.TRANSLATION) >= 99


def _model_of(walk: Walk) -> MotionModel:
    """Return the motion model of a walk before its track is finished."""
    rig = simulated_rig()
    pipeline = Pipeline(rig.calibration, rig.instrument.frame_shape)
    for index, frame in enumerate(recorded(walk)[0]):
        pipeline.track(frame, index)
    turns = any(pose.angle for pose in pipeline.poses)
    return MotionModel.RIGID if turns else MotionModel.TRANSLATION
