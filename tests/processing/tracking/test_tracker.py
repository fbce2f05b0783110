from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from napari_elsplus.processing.images.sectioning import Mode
from napari_elsplus.processing.tracking.front_end.grid import Grid
from napari_elsplus.processing.tracking.motion.pose import TrackingState
from napari_elsplus.processing.tracking.motion.rolling_shutter import RollingShutter, Velocity, Warp
from napari_elsplus.processing.tracking.pose_graph.refinement import borne_out, settle
from napari_elsplus.processing.tracking.registration.motion_models import turned_by
from napari_elsplus.processing.tracking.registration.pair_registration import PairRegistration, Registrar
from napari_elsplus.processing.tracking.tracker import Tracker
from napari_elsplus.simulation.specimen.trajectories import Recorded, Spiral, Turning
from napari_elsplus.workflows.sectioning import RawPairs
from napari_elsplus.workflows.tracking import Pipeline
from recordings import Truth, fibres, record, smooth_path, texture
from simulated import INSTRUMENT, followed


def track(truth: Truth, *, finish: bool = True) -> Pipeline:
    pipeline = Pipeline(truth.calibration, truth.frames.shape[1:])
    pairs = RawPairs(truth.frames, Mode.ELS)
    for index in range(len(pairs)):
        pipeline.track(pairs(index)[0], index)
    if finish:
        pipeline.finish(pairs)
    return pipeline


def errors(pipeline: Pipeline, truth: Truth) -> tuple[np.ndarray, float]:
    """Pair errors of tracked links, px, and the drift of the segments in percent of their path."""
    rows = pipeline.rows
    place = np.array([(row.row_px, row.col_px) for row in rows])
    good = np.array([row.state == "tracked" for row in rows])
    segment = np.array([row.segment for row in rows])
    same = good[1:] & good[:-1] & (segment[1:] == segment[:-1])
    pair = np.hypot(*(np.diff(place, axis=0) - np.diff(truth.positions, axis=0)).T)[same]
    step = np.hypot(*np.diff(truth.positions, axis=0).T)
    drift = path = 0.0
    for number in np.unique(segment[good]):
        at = np.flatnonzero(good & (segment == number))
        ends = [place[at[-1]] - place[at[0]], truth.positions[at[-1]] - truth.positions[at[0]]]
        drift += float(np.hypot(*(ends[0] - ends[1])))
        path += float(step[at[0] : at[-1]].sum())
    return pair, 100 * drift / path


@pytest.mark.parametrize(
    ("speed", "options", "pair_px", "drift_percent"),
    [
        (33.0, {}, 0.03, 0.02),
        (33.0, {"right": (126.4, 355.2), "gain": 0.93, "turn_deg": 0.3}, 0.03, 0.02),
        (33.0, {"photons": 150.0}, 0.05, 0.04),
        (0.5, {}, 0.03, 0.2),
    ],
    ids=["fast", "offset of the other sign, right view turned and darker", "dim", "slow"],
)
def test_textured_scenes(speed: float, options: dict[str, float], pair_px: float, drift_percent: float) -> None:
    truth = record(fibres(1200, 300, 2), smooth_path(50, speed, 1200, 3), **options)  # type: ignore[arg-type]
    pipeline = track(truth)
    pair, drift = errors(pipeline, truth)
    assert {row.state for row in pipeline.rows} == {"tracked"}
    assert np.median(pair) < pair_px
    assert drift < drift_percent


def test_sparse_fibres_are_tracked_where_they_can_be_and_nowhere_else() -> None:
    truth = record(fibres(1200, 45, 3, half_length_px=(80, 250)), smooth_path(60, 28.0, 1200, 5), seed=3)
    pipeline = track(truth)
    pair, drift = errors(pipeline, truth)
    assert (pair > 3).sum() == 0
    assert len(pair) > 0.6 * 59
    assert np.median(pair) < 0.3
    assert drift < 0.5


def test_a_start_of_low_odds_is_kept_once_the_next_registration_agrees() -> None:
    """One fibre or two in view: by the odds of single pairs 7 frames are tracked, none of the first nine."""
    truth = record(fibres(700, 8, 14), smooth_path(16, 20, 700, 14))
    pipeline = track(truth)
    tracked = [pose.state is TrackingState.TRACKED for pose in pipeline.poses]
    assert sum(tracked) >= 10
    assert any(tracked[:9])
    assert errors(pipeline, truth)[0].max() < 2.0


class Scripted(Registrar):
    """Returns registrations of frames at rest whose odds and correlations are given, those of each search in turn.

    A third number is the correlation at half resolution, if it differs.
    """

    registers_warps = False

    def __init__(self, grid: Grid, found: list[tuple[float, ...] | None]) -> None:
        super().__init__(grid)
        self._script = iter(found)

    def register(self, *_: Any, **__: Any) -> PairRegistration | None:
        found = next(self._script)
        if found is None:
            return None
        odds, correlation, *at_half = found
        link = PairRegistration(Warp(1.0, 0.0, 0.0, 0.0), 1e4 * np.eye(4), correlation, 1.0, odds, Velocity(0, 0), 0.01)
        return link._replace(at_half=at_half[0] if at_half else correlation)


@pytest.mark.parametrize(
    ("correlation", "state"), [(0.98, TrackingState.TRACKED), (0.34, TrackingState.LOST)], ids=["alike", "unlike"]
)
def test_a_start_is_confirmed_by_frames_that_correlate_as_its_own(correlation: float, state: TrackingState) -> None:
    """What follows a first registration correlates about as well, as what follows any other does."""
    grid = Grid(116, 1, (0, 0), (57.5, 57.5), 112.0, RollingShutter(150.0))
    low, high = (7.0, 0.99), (40.0, correlation)
    tracker = Tracker(Scripted(grid, [low, low, None, high, None]))
    poses = [tracker.add() for _ in range(3)]
    assert poses[2].state is state
    assert len(tracker.links) == (2 if state is TrackingState.TRACKED else 0)


def test_high_passed_frames_are_not_expected_to_correlate_as_well_as_frames_as_they_are() -> None:
    """Hazy tissue at the limit of both was lost wherever it went from the one to the other: 17 of 50 frames tracked."""
    grid = Grid(116, 1, (0, 0), (57.5, 57.5), 112.0, RollingShutter(150.0))
    whole, high_passed, unlike = (40.0, 0.994, 0.92), (40.0, 0.80, 0.91), (40.0, 0.80, 0.84)
    tracker = Tracker(Scripted(grid, [whole, whole, high_passed, whole, high_passed, unlike, None]))
    states = [tracker.add().state for _ in range(7)]
    assert states[:6] == [TrackingState.TRACKED] * 6
    assert states[6] is not TrackingState.TRACKED


def test_the_first_high_passed_frames_are_expected_to_be_as_alike_as_those_before() -> None:
    """None had been registered before, so any were accepted: of rich tissue with jolts 6 of 652 were wrong."""
    grid = Grid(116, 1, (0, 0), (57.5, 57.5), 112.0, RollingShutter(150.0))
    whole, unlike = (40.0, 0.994, 0.92), (40.0, 0.80, 0.84)
    tracker = Tracker(Scripted(grid, [whole, whole, unlike, None]))
    states = [tracker.add().state for _ in range(4)]
    assert states == [TrackingState.TRACKED] * 3 + [TrackingState.PREDICTED]


def standing(found: list[tuple[float, float] | None], frames: int) -> tuple[list[int], list[int]]:
    """Frames whose registration stands, and those that are tracked in the end, of a tracker with scripted searches."""
    grid = Grid(116, 1, (0, 0), (57.5, 57.5), 112.0, RollingShutter(150.0))
    tracker = Tracker(Scripted(grid, found))
    poses = [tracker.add() for _ in range(frames)]
    links = borne_out(poses, tracker.links)
    tracked = [k for k, pose in enumerate(settle(poses, links)) if pose.state is TrackingState.TRACKED]
    return [link.later for link in links], tracked


LINKED, SURE, LOW = (40.0, 0.99), (400.0, 0.99), (7.0, 0.99)


@pytest.mark.parametrize(
    ("found", "frames", "stand", "tracked"),
    [
        ([LINKED, LINKED, LINKED], 4, [1, 2, 3], [0, 1, 2, 3]),
        ([LINKED, LINKED, None], 4, [1], [0, 1]),
        ([LINKED, SURE, None], 4, [1, 2], [0, 1, 2]),
        ([LINKED, LINKED, None, LINKED], 5, [1, 4], [0, 1, 4]),
        ([LOW, LOW, None, LINKED], 3, [1, 2], [0, 2]),
        ([LOW, LOW, None, LINKED, None], 4, [], [0]),
    ],
    ids=["followed", "not followed", "sure", "not followed, then found", "start", "start that is not followed"],
)
def test_a_link_stands_if_it_is_sure_or_a_later_frame_is_linked(
    found: list[tuple[float, float] | None], frames: int, stand: list[int], tracked: list[int]
) -> None:
    assert standing(found, frames) == (stand, tracked)


def blinded(truth: Truth, first: int, last: int, level: int = 4) -> Truth:
    frames = truth.frames.copy()
    frames[first:last] = level
    return Truth(frames, truth.calibration, truth.positions, truth.starts, truth.scene)


def test_a_short_blackout_is_bridged_and_said() -> None:
    truth = record(texture(1000, 4), smooth_path(20, 12.0, 1000, 4))
    pipeline = track(blinded(truth, 8, 10))
    states = [row.state for row in pipeline.rows]
    assert states == ["tracked"] * 8 + ["predicted"] * 2 + ["tracked"] * 10
    place = np.array([(row.row_px, row.col_px) for row in pipeline.rows])
    assert np.abs(place - (truth.positions - truth.positions[0])).max() < 1.0


def test_a_turning_probe_that_was_lost_is_expected_to_turn_on_as_before() -> None:
    """By half a turn in one segment, which is no turn from there to the next one: that starts upright."""
    path, dark = Turning(Spiral(8000.0), 250.0), slice(160, 167)
    seen = followed(path, "fibres", 180, dark=dark, finish=False)
    poses, angle = seen.pipeline.poses, path.angles_rad(seen.times_s)
    states = [(pose.segment, pose.state.value) for pose in poses[159:]]
    assert states == [(0, "tracked"), *5 * [(0, "predicted")], *3 * [(0, "lost")], *12 * [(1, "tracked")]]
    for first, frames in ((159, range(160, 165)), (168, range(168, 180))):
        turned = np.array([poses[k].angle for k in frames]) - poses[first].angle
        assert np.abs(np.rad2deg(turned - angle[frames] + angle[first])).max() < 0.2
    upright = turned_by(float(poses[168].angle - angle[168]))
    moved = (seen.positions_px[168:] - seen.positions_px[168]) @ upright.T
    assert np.abs(seen.found_px[168:] - seen.found_px[168] - moved).max() < 0.3


def test_a_probe_goes_on_turning_while_the_camera_loses_frames() -> None:
    """By 3.1 degrees in three lost frames; registered anew once the turning is known, the frames are as far apart."""
    path = Turning(Spiral(8000.0), 250.0)
    for finish in (False, True):
        seen = followed(path, "fibres", 50, lost=slice(30, 33), finish=finish)
        poses = seen.pipeline.poses
        assert {(pose.segment, pose.state.value) for pose in poses} == {(0, "tracked")}
        turned = np.array([pose.angle for pose in poses]) - path.angles_rad(seen.times_s)
        assert np.abs(np.rad2deg(turned[20:] - turned[20])).max() < 0.2
        upright = turned_by(float(turned[20]))
        moved = (seen.positions_px - seen.positions_px[20]) @ upright.T
        assert np.abs(seen.found_px - seen.found_px[20] - moved)[20:].max() < 0.8  # 0.6 where no frame is lost


def test_a_first_frame_that_shows_nothing_is_lost() -> None:
    """Nothing was linked to it: it has no place among the others, which are one segment."""
    truth = record(fibres(1200, 300, 4), smooth_path(16, 20.0, 1200, 5))
    truth.frames[0] = 0
    states = [row.state for row in track(truth).rows]
    assert states[0] == "lost"
    assert set(states[1:]) == {"tracked"}
    assert {row.segment for row in track(truth).rows[1:]} == {0}


def test_a_long_blackout_splits_the_track_and_a_known_place_joins_it_again() -> None:
    """The probe runs along a line and back: the second segment shows what the first one saw."""
    there = np.linspace((500.0, 350.0), (500.0, 650.0), 17)
    truth = record(texture(1000, 5), np.concatenate([there, there[::-1]]))
    dark = blinded(truth, 14, 23)
    live = track(dark, finish=False)
    assert [row.segment for row in live.rows if row.state == "tracked"] == [0] * 14 + [1] * (33 - 24)
    pipeline = track(dark)
    assert [row.state for row in pipeline.rows[14:]] == ["lost"] * 9 + ["tracked"] * 10
    assert {row.segment for row in pipeline.rows} == {0}
    place = np.array([(row.row_px, row.col_px) for row in pipeline.rows])[23:]
    assert np.abs(place - (truth.positions - truth.positions[0])[23:]).max() < 0.3


def test_a_lost_frame_is_searched_for_in_one_earlier_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    """That is what a frame costs while the probe jumps, or is off the tissue."""
    elsewhere = np.random.default_rng(3).uniform(300, 1700, (14, 2))
    truth = record(texture(2000, 5), np.concatenate([smooth_path(6, 2.0, 2000, 1), elsewhere]))
    searches = [0]
    search = Registrar._searched

    def counted(*arguments: Any) -> Any:
        searches[-1] += 1
        return search(*arguments)

    monkeypatch.setattr(Registrar, "_searched", counted)
    pipeline, pairs = Pipeline(truth.calibration, truth.frames.shape[1:]), RawPairs(truth.frames, Mode.ELS)
    for index in range(len(pairs)):
        pipeline.track(pairs(index)[0], index)
        searches.append(0)
    assert {row.state for row in pipeline.rows[12:]} == {"lost"}
    assert max(searches[6:]) == 2
    assert max(searches[12:]) == 1


@pytest.mark.parametrize("level", [0, 4, 255])
def test_a_recording_without_structure_is_lost_after_its_first_frame(level: int) -> None:
    truth = record(texture(600, 6), np.full((8, 2), 300.0))
    pipeline = track(blinded(truth, 0, 7, level))
    assert [row.state for row in pipeline.rows] == ["tracked"] + ["lost"] * 6
    assert all(np.isnan(row.row_px) for row in pipeline.rows[1:])


def test_frames_without_the_laser_are_not_tracked_by_the_background_that_they_lack() -> None:
    """What is taken off all of them alike, the noise of its few frames included, stands still: they were a segment."""
    truth, random = record(texture(1000, 4), smooth_path(14, 6.0, 1000, 4), haze=0.2), np.random.default_rng(1)
    glow = 0.2 * record(np.ones((600, 600), np.float32), np.full((2, 2), 300.0), haze=0.0).frames[0].astype(np.float32)
    frames = np.rint(0.5 * truth.frames + glow).astype(np.uint8)
    frames[:7] = np.rint(random.normal(4, 0.8, frames[:7].shape))
    background = 4 + glow + random.normal(0, 0.8, glow.shape).astype(np.float32)
    calibration = truth.calibration.model_copy(update={"background": background})
    states = [row.state for row in track(replace(truth, frames=frames, calibration=calibration)).rows]
    assert "tracked" not in states[:7]
    assert set(states[8:]) == {"tracked"}


@pytest.mark.parametrize(("dtype", "limit"), [(np.uint8, 255), (np.uint16, 4095)])
def test_overexposed_frames_are_not_tracked_by_the_cores(dtype: type, limit: int) -> None:
    """Divided by the flat field, saturated pixels show its pattern, which stands still: 33 of 39 moves were wrong."""
    truth = record(texture(1000, 4), smooth_path(6, 6.0, 1000, 4))
    frames = np.minimum(limit / 255 * 2.5 * truth.frames.astype(np.float64), limit).astype(dtype)
    assert {row.state for row in track(replace(truth, frames=frames)).rows[1:]} == {"lost"}


def test_frames_a_third_saturated_are_tracked_where_the_background_shows_the_cores() -> None:
    """The cores that are saturated stand still; with what they lack estimated they do not."""
    truth = record(texture(1000, 4), smooth_path(20, 5.0, 1000, 4))
    glow = 0.1 * (record(np.ones((600, 600), np.float32), np.full((2, 2), 300.0), haze=0.0).frames[0] - 4.0)
    frames = np.rint(np.minimum(1.8 * (truth.frames - 4.0) + 4.0 + glow, 255)).astype(np.uint8)
    calibration = truth.calibration.model_copy(update={"background": (4.0 + glow).astype(np.float32)})
    seen = replace(truth, frames=frames, calibration=calibration)
    pipeline = track(seen)
    assert {row.state for row in pipeline.rows} == {"tracked"}
    pair, _ = errors(pipeline, seen)
    assert pair.max() < 0.12
    assert np.sqrt(np.mean((pair / [row.sigma_px for row in pipeline.rows[1:]]) ** 2)) < 1.2


def test_one_frame_is_a_track_of_one() -> None:
    truth = record(texture(600, 7), np.full((2, 2), 300.0))
    pipeline = track(truth)
    assert [(row.state, row.row_px, row.col_px) for row in pipeline.rows] == [(TrackingState.TRACKED, 0.0, 0.0)]
    assert len(pipeline.mosaics) == 1


def test_frames_of_nan_are_lost_and_spoil_no_others() -> None:
    truth = record(texture(1000, 4), smooth_path(12, 12.0, 1000, 4))
    frames = truth.frames.astype(np.float32)
    frames[6] = np.nan
    broken = Truth(frames, truth.calibration, truth.positions, truth.starts, truth.scene)  # type: ignore[arg-type]
    pipeline = track(broken)
    assert [row.state for row in pipeline.rows] == ["tracked"] * 6 + ["predicted"] + ["tracked"] * 5
    assert np.isfinite(pipeline.mosaics[0].read()[0]).all()


@pytest.mark.parametrize("level", [255, 40])
def test_a_recording_of_one_level_is_lost_though_the_flat_field_has_structure(level: int) -> None:
    truth = record(texture(600, 6), np.full((6, 2), 300.0), gain=0.9)
    pipeline = track(blinded(truth, 0, 5, level))
    assert [row.state for row in pipeline.rows] == ["tracked"] + ["lost"] * 4


def uneven(change_px: float, seed: int) -> Recorded:
    """A path whose velocity takes a new value each frame, evenly in between, camera pixels per frame."""
    rng = np.random.default_rng(seed)
    knots = 15.0 + rng.normal(0, change_px / 2, (34, 2))
    t = np.arange(0, 32, 1 / 16)
    velocity = np.stack([np.interp(t, np.arange(len(knots)), knot) for knot in knots.T], 1)
    optics = INSTRUMENT.optics
    return Recorded(t * optics.frame_period_s, np.cumsum(velocity, axis=0) / 16 * optics.um_per_px)


@pytest.mark.parametrize("change_px", [4.0, 20.0, 60.0])
def test_jerks_show_in_the_uncertainty_or_are_refused(change_px: float) -> None:
    """Links are as wrong as they say, and none is called tracked that is 3 px off."""
    seen = followed(uneven(change_px, 1), "fibres", 30, finish=False)
    rows = seen.pipeline.rows
    step = np.diff(seen.found_px, axis=0) - np.diff(seen.positions_px, axis=0)
    linked = np.array([a.state == b.state == "tracked" and a.segment == b.segment for a, b in pairwise(rows)])
    error, said = np.hypot(*step.T)[linked], np.array([row.sigma_px for row in rows[1:]])[linked]
    assert (error > 3).sum() == 0
    assert 0.3 < np.sqrt(np.mean((error / said) ** 2) / 2) < 3
    assert linked.all() == (change_px < 30)
    assert linked.sum() > 5
