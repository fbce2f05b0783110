from __future__ import annotations

import subprocess
import sys
from functools import cache

import numpy as np
import pytest

from napari_elsplus.acquisition.mosaic import tracking
from napari_elsplus.acquisition.mosaic.board import MosaicBoard
from napari_elsplus.acquisition.mosaic.feed import MosaicFeed
from napari_elsplus.acquisition.mosaic.tracking import LiveTrack
from napari_elsplus.acquisition.streaming.ring import Stamp
from napari_elsplus.errors import InputError
from napari_elsplus.workflows.mosaic_plan import MosaicPlan
from napari_elsplus.workflows.tracking import Pipeline
from recordings import Truth, record, smooth_path, texture

FRAMES = 40


@cache
def truth() -> Truth:
    return record(texture(700, 3), smooth_path(FRAMES, 9.0, 700, 4))


def stamp(number: int, later_s: float = 0.0) -> Stamp:
    return Stamp(100 + number, later_s + number / 240, number / 240, number)


def test_a_stream_without_end_is_tracked_alike_in_bounded_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tracking, "LOCAL_ROWS", 7)
    board = MosaicBoard()
    frames, calibration = truth().frames, truth().calibration
    live = LiveTrack(calibration, frames.shape[1:], board=board)
    alone = Pipeline(calibration, frames.shape[1:])
    feed = MosaicFeed(board.name)
    try:
        for k, frame in enumerate(frames):
            live.add(frame, stamp(k))
            alone.add(frame, k, k / 240)
            assert len(live.pipeline.rows) <= 8
        feed.update()
        assert [(row.frame, row.row_px, row.state) for row in feed.rows] == [
            (row.frame, row.row_px, row.state) for row in alone.rows
        ]
        extent = alone.mosaics[0].extent
        np.testing.assert_array_equal(feed.canvases[0][0].read(extent)[0], alone.mosaics[0].read()[0])
        assert live.state.counts == {"tracked": FRAMES}
        assert live.state.newest == feed.rows[-1]
        assert live.undo()
        assert live.state.counts == {"lost": FRAMES}
        assert not live.undo()
    finally:
        feed.close()
        live.close()
    live.add(frames[0], stamp(FRAMES))  # a frame that was on its way


def test_nothing_is_left_to_compile_when_frames_come() -> None:
    """In a process of its own: here other tests have compiled all of it."""
    script = """
from napari_elsplus.acquisition.mosaic.tracking import warm_up
from benchmarks.rigs.simulated import simulated_rig
from napari_elsplus.processing.tracking.registration import (
    motion_models, odds, pyramid, pyramid_descent,
)
from napari_elsplus.workflows.tracking import Pipeline

rig = simulated_rig()
warm_up(Pipeline(rig.calibration, rig.instrument.frame_shape), rig.instrument.frame_shape)
called = (
    pyramid_descent.register, pyramid.fill_levels, odds.weakest_direction, motion_models.score_rotation,
    motion_models.largest_saving,
)
print([kernel.__name__ for kernel in called if not kernel.signatures])
"""
    said = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout
    assert said.strip() == "[]"


def test_no_registration_is_kept_once_its_frame_is_inserted() -> None:
    """Before, an hour without a board kept 864,000 of them, more than a gigabyte."""
    frames, calibration = truth().frames, truth().calibration
    live = LiveTrack(calibration, frames.shape[1:], MosaicPlan())
    for k in range(4):
        live.add(frames[k], stamp(k))
        assert live.pipeline.tracking.newest_registration is None
    assert live.state.counts == {"tracked": 4}


def test_frames_that_the_stream_lost_are_told_by_its_numbers() -> None:
    frames, calibration = truth().frames, truth().calibration
    live = LiveTrack(calibration, frames.shape[1:], MosaicPlan())
    alone = Pipeline(calibration, frames.shape[1:])
    for k in [*range(12), *range(16, 30)]:
        live.add(frames[k], stamp(k))
        alone.tracking.skip(4 if k == 16 else 0)
        alone.add(frames[k], k, k / 240)
    assert repr(live.pipeline.rows) == repr(alone.rows)
    assert {row.state for row in alone.rows} == {"tracked"}


def test_a_stream_whose_first_frame_did_not_fit_begins_with_the_next() -> None:
    """Before: an IndexError, as the frames of a stream that starts again continue those that were tracked."""
    frames, calibration = truth().frames, truth().calibration
    live = LiveTrack(calibration, frames.shape[1:], MosaicPlan())
    with pytest.raises(InputError, match="all frames of a recording must have one size"):
        live.add(frames[0][:-8], stamp(5))
    live.add(frames[0], stamp(2, later_s=2.0))
    live.add(frames[1], stamp(3, later_s=2.0))
    assert [(row.frame, round(240 * row.time_s)) for row in live.pipeline.rows] == [(0, 0), (1, 1)]


def test_a_stream_that_starts_again_goes_on_counting() -> None:
    frames, calibration = truth().frames, truth().calibration
    live = LiveTrack(calibration, frames.shape[1:], MosaicPlan())
    for k in range(4):
        live.add(frames[k], stamp(k))
    for k in range(3):
        live.add(frames[4 + k], stamp(k, later_s=2.0))
    assert [row.frame for row in live.pipeline.rows] == list(range(7))
    times = np.array([row.time_s for row in live.pipeline.rows])
    assert (np.diff(times) > 0).all()
    assert times[4] - times[3] == pytest.approx(2.0 - 3 / 240)
