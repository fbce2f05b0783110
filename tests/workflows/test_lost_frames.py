"""Frames that the camera lost: the probe went on moving meanwhile, as the gaps in the frame numbers tell."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from napari_elsplus.io import open_recording
from napari_elsplus.io.recorder import RecordingWriter
from napari_elsplus.processing.images.sectioning import Mode
from napari_elsplus.viewing.mosaic.recorded import StackMosaics
from napari_elsplus.workflows.mosaic_plan import MosaicPlan
from napari_elsplus.workflows.mosaicing import mosaic, track
from napari_elsplus.workflows.sectioning import RawPairs, section
from napari_elsplus.workflows.tracking import Pipeline
from recordings import Truth, fibres, record, smooth_path

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from napari_elsplus.io.tables.tracks import TrackPoint

FRAMES = 60


@pytest.fixture(scope="module")
def truth() -> Truth:
    return record(fibres(1200, 300, 2), smooth_path(FRAMES, 16.0, 1200, 3))


def kept(lost: Sequence[int]) -> np.ndarray:
    return np.setdiff1d(np.arange(FRAMES), lost)


def errors_px(rows: Sequence[TrackPoint], positions: np.ndarray) -> np.ndarray:
    """Vectors from where the frames were to where they are found, relative to the first."""
    place = np.array([(row.row_px, row.col_px) for row in rows])
    return place - place[0] - positions + positions[0]


@pytest.mark.parametrize(
    "lost",
    [
        np.random.default_rng(5).choice(np.arange(4, FRAMES), 10, replace=False),
        np.r_[15:18, 30:34, 45:50],
        np.r_[8:17, 20:28],  # more than the tracker waits for frames that come and show nothing
    ],
    ids=["single ones", "short bursts", "long bursts"],
)
def test_a_track_goes_on_over_lost_frames(truth: Truth, lost: np.ndarray) -> None:
    numbers = kept(lost)
    rows = track(truth.frames[numbers], truth.calibration, frame_numbers=7 + numbers)
    assert {(row.segment, row.state) for row in rows} == {(0, "tracked")}
    errors = errors_px(rows, truth.positions[numbers])
    assert np.hypot(*errors.T).max() < 0.5
    sigmas = np.array([row.sigma_px for row in rows[1:]])
    assert (np.hypot(*np.diff(errors, axis=0).T) < 4 * sigmas).all()


def test_the_velocity_after_lost_frames_is_that_of_the_probe(truth: Truth) -> None:
    numbers = kept(np.r_[20:24])
    pipeline = Pipeline(truth.calibration, truth.frames.shape[1:])
    pairs = RawPairs(truth.frames[numbers], "els", numbers)
    for index in range(len(pairs)):
        pipeline.tracking.skip(pairs.lost_before(index))
        pipeline.track(pairs(index)[0], index)
    moved = np.diff(truth.starts, axis=0)[numbers]  # in the period of each frame
    velocities = np.array([pose.velocity for pose in pipeline.poses])
    assert np.abs(velocities[1:] - moved[1:]).max() < 1.0
    pipeline.finish(pairs)
    velocities = np.array([pose.velocity for pose in pipeline.poses])
    assert np.abs(velocities - moved).max() < 1.0


@pytest.mark.parametrize("mode", ["els", "elsa"])
def test_recordings_tell_the_lost_frames_themselves(truth: Truth, tmp_path: Path, mode: str) -> None:
    numbers, path = kept(np.r_[20:24]), tmp_path / "gap.ome.tif"
    period_s = truth.calibration.frame_period_s
    assert period_s is not None
    with RecordingWriter(path, truth.frames.shape[1:], np.uint8, calibration=truth.calibration) as writer:
        for number in numbers:
            writer.append(truth.frames[number], time_s=number * period_s, frame_number=int(number))
    frames = truth.frames[numbers]
    with open_recording(path) as recording:
        by_recording = track(recording, truth.calibration, mode)
        one = mosaic(recording, truth.calibration, mode, threads=1).track
        two = mosaic(recording, truth.calibration, mode, threads=2).track
    given = track(frames, truth.calibration, mode, times_s=numbers * period_s, frame_numbers=numbers)
    untold = track(frames, truth.calibration, mode, times_s=numbers * period_s)
    assert repr(by_recording) == repr(one) == repr(two) == repr(given)
    assert repr(untold) != repr(given)
    plan = MosaicPlan((Mode(mode),))
    shown = StackMosaics(frames, truth.calibration, plan, numbers * period_s, numbers)
    shown.run()
    assert repr(list(shown.rows)) == repr(given)


def test_lost_images_are_counted_between_the_confocal_frames_of_successive_ones() -> None:
    frames = np.zeros((8, 4, 6), np.uint8)
    numbers = np.array([3, 4, 5, 9, 10, 11, 0, 1])  # the camera was started again before the last two
    pairs = RawPairs(frames, "els", numbers)
    assert [pairs.lost_before(k) for k in range(8)] == [0, 0, 0, 3, 0, 0, 0, 0]
    pairs = RawPairs(frames, "elsa", np.array([3, 4, 5, 9, 10, 11, 16, 17]))
    assert [pairs.lost_before(k) for k in range(4)] == [0, 0, 1, 2]
    assert [RawPairs(frames, "els").lost_before(k) for k in range(8)] == [0] * 8


def test_frames_of_which_most_were_lost_have_the_rate_of_their_camera(tmp_path: Path) -> None:
    """By their numbers: no other frame rate than the calibration's is noted, and images have its interval."""
    scene = record(fibres(1200, 300, 2), smooth_path(24, 8.0, 1200, 3))
    period_s = scene.calibration.frame_period_s
    assert period_s is not None
    with RecordingWriter(tmp_path / "r.ome.tif", scene.frames[0].shape, np.uint8, calibration=scene.calibration) as own:
        for number in range(0, 24, 2):
            own.append((scene.frames[number] // 2).astype(np.uint8), period_s * number, number)
    with open_recording(own.path) as raw:
        calibration = scene.calibration
        mosaics = StackMosaics(raw, calibration, MosaicPlan((Mode.ELS,)), raw.times_s, raw.frame_numbers)
        mosaics.run()
        for notes in (mosaic(raw, calibration).notes, mosaics.notes):
            assert [note for note in notes if "ms apart" in note] == []
        assert section(raw, calibration).frame_period_s == pytest.approx(period_s)
