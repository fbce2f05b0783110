"""Loops closed while frames come: against the truth, behind a tracker that drifts, and never in its way."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from napari_elsplus.acquisition.mosaic import loop_closure as closing
from napari_elsplus.acquisition.mosaic import tracking as live_tracking
from napari_elsplus.acquisition.mosaic.board import MosaicBoard
from napari_elsplus.acquisition.mosaic.feed import MosaicFeed
from napari_elsplus.acquisition.mosaic.tracking import LiveTrack
from napari_elsplus.acquisition.streaming.ring import Stamp
from napari_elsplus.errors import DeviceError
from napari_elsplus.io import TrackPoint
from napari_elsplus.processing.images.sectioning import Mode
from napari_elsplus.processing.mosaicing.mosaic import Insertion, Mosaic
from napari_elsplus.processing.tracking import tracker as tracking
from napari_elsplus.processing.tracking.registry import Method
from napari_elsplus.workflows.mosaic_plan import MosaicPlan
from napari_elsplus.workflows.tracking import Pipeline
from recordings import Truth, record, texture

ROUND = 60
SPEED = 12.0
AGAIN = 20
"""Frames of the second round until the loop counts as closed."""
DRIFT = np.array([0.03, -0.02])
"""Pixels that each frame adds, in tests with a tracker that drifts: 0.3 % of the path."""


@cache
def truth() -> Truth:
    """A probe that goes round twice."""
    t = 2 * np.pi * np.arange(2 * ROUND + 11) / ROUND
    radius = SPEED * ROUND / (2 * np.pi)
    return record(texture(700, 3), 350 + radius * np.stack([np.sin(t), np.cos(t)], 1))


class Look:
    """A live track on a board, and who looks at it."""

    def __init__(self, plan: MosaicPlan) -> None:
        self.board = MosaicBoard()
        self.live = LiveTrack(truth().calibration, truth().frames.shape[1:], plan, self.board)
        self.feed = MosaicFeed(self.board.name, blended=plan.insertion is Insertion.FEATHERED)
        self._added = 0

    def add(self, frames: NDArray[np.uint8]) -> None:
        for frame in frames:
            self.live.add(frame, Stamp(100 + self._added, self._added / 240, self._added / 240, self._added))
            self._added += 1

    def rows(self) -> list[TrackPoint]:
        self.feed.update()
        return self.feed.rows


@pytest.fixture
def looks(request: pytest.FixtureRequest) -> Iterator[Look]:
    look = Look(getattr(request, "param", MosaicPlan()))
    yield look
    look.feed.close()
    look.live.close()


@pytest.fixture
def drifts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let every frame be tracked a little off, in one direction, as no tracker of ours is."""
    place = tracking.Tracker._place

    def off(self, earlier, here, link, motion):
        fits = place(self, earlier, here, link, motion)
        if fits:
            here.at += complex(*DRIFT)
        return fits

    monkeypatch.setattr(tracking.Tracker, "_place", off)


def errors(rows: Sequence[TrackPoint], frames: Sequence[int] | None = None) -> NDArray[np.float64]:
    """Distance of each row from the truth, camera pixels; the first frame lies where it is."""
    true = truth().positions[: len(rows)] if frames is None else truth().positions[list(frames)]
    found = np.array([(row.row_px, row.col_px) for row in rows])
    return np.hypot(*(found - found[0] - true + true[0]).T)


def alike(one: Mosaic, other: Mosaic) -> float:
    """Correlation of two mosaics where both were drawn on."""
    extent = one.extent.intersection(other.extent)
    (a, drawn), (b, there) = one.read(extent), other.read(extent)
    both = (drawn > 0.5) & (there > 0.5)
    return float(np.corrcoef(a[both], b[both])[0, 1])


@pytest.fixture(scope="module")
def without_drift() -> Mosaic:
    """The mosaic of the same frames, tracked as well as we can and laid where the graph puts them."""
    frames = truth().frames
    pipeline = Pipeline(truth().calibration, frames.shape[1:])
    for k, frame in enumerate(frames):
        pipeline.add(frame, k)
    pipeline.finish(lambda k: (frames[k], frames[k]))
    return pipeline.mosaics[0]


LIVE = [how for how in Insertion if how.while_acquiring]


@pytest.mark.parametrize("looks", [MosaicPlan(insertion=how) for how in LIVE], indirect=True, ids=LIVE)
def test_a_probe_that_comes_back_is_put_where_it_was_and_what_lies_between_shares_the_error(
    looks: Look, without_drift: Mosaic, drifts: None
) -> None:
    frames = truth().frames
    alone = Pipeline(truth().calibration, frames.shape[1:])
    for k, frame in enumerate(frames):
        alone.add(frame, k)
    drifted = errors(alone.rows)
    looks.add(frames[: ROUND + AGAIN])
    looks.live.settle()
    assert looks.live.state.loop_closures > 5
    looks.add(frames[ROUND + AGAIN : ROUND + AGAIN + 3])
    new = errors(looks.rows())[-3:]
    assert drifted[ROUND + AGAIN] > 2.5
    assert new.max() < 0.15 * drifted[ROUND + AGAIN]  # new tissue lands on old at once
    looks.add(frames[ROUND + AGAIN + 3 :])
    looks.live.settle()
    assert errors(looks.rows()).max() < 0.05 * drifted.max()
    clear = alike(looks.feed.canvases[0][0], without_drift)
    assert clear > 0.99 > 0.96 > alike(alone.mosaics[0], without_drift)


@pytest.mark.parametrize(
    "looks", [MosaicPlan((Mode.LS, Mode.ELSA, Mode.ELS), how) for how in Method], indirect=True, ids=list(Method)
)
def test_modes_side_by_side_are_those_of_the_recording(looks: Look) -> None:
    frames, shape = truth().frames[: ROUND // 2], truth().frames.shape[1:]
    looks.add(frames)
    looks.live.settle()
    looks.rows()
    plan = looks.live.state.plan
    pipelines = {mode: Pipeline(truth().calibration, shape, mode, method=plan.method) for mode in plan.modes}
    for k, frame in enumerate(frames):
        pipelines[Mode.ELS].add(frame, k)
        pose = pipelines[Mode.ELS].poses[-1]
        pipelines[Mode.LS].insert_raw(pose, k, frame)
        if k % 2 == 0 and k + 1 < len(frames):
            pipelines[Mode.ELSA].insert_raw(pose, k, frame, frames[k + 1])
    for image, pipeline in enumerate(pipelines.values()):
        mosaic = pipeline.mosaics[0]
        np.testing.assert_array_equal(looks.feed.canvases[image][0].read(mosaic.extent)[0], mosaic.read()[0])
    assert [(row.row_px, row.state) for row in looks.rows()] == [
        (row.row_px, row.state) for row in pipelines[Mode.ELS].rows
    ]


@pytest.mark.parametrize("looks", [MosaicPlan((Mode.LS, Mode.ELS))], indirect=True)
def test_a_segment_that_begins_anew_is_joined_where_it_is_recognised(looks: Look, without_drift: Mosaic) -> None:
    frames, lifted = truth().frames, np.zeros((12, *truth().frames.shape[1:]), np.uint8)
    looks.add(frames[:30])
    looks.add(lifted)
    looks.add(frames[ROUND - 6 : ROUND + 30])
    looks.live.settle()
    rows = looks.rows()
    assert rows[35].state == "lost"
    assert rows[-1].segment == 0
    assert set(looks.feed.canvases[0]) == set(looks.feed.canvases[1]) == {0}
    back = range(ROUND, ROUND + 30)
    assert errors([rows[0], *rows[-30:]], [0, *back]).max() < 0.5
    assert alike(looks.feed.canvases[1][0], without_drift) > 0.99


def test_an_undone_segment_stays_away_and_what_comes_after_is_corrected(looks: Look, drifts: None) -> None:
    looks.add(truth().frames[: ROUND + AGAIN])
    assert looks.live.undo()
    looks.live.settle()
    assert all(row.state == "lost" for row in looks.rows())
    assert not looks.feed.canvases
    looks.add(truth().frames[AGAIN : 2 * ROUND])
    looks.live.settle()
    rows = looks.rows()
    assert all(row.state == "lost" and np.isnan(row.row_px) for row in rows[: ROUND + AGAIN])
    later = [row for row in rows[ROUND + AGAIN :] if row.state == "tracked"]
    assert len(later) > ROUND
    assert errors(later, range(2 * ROUND - len(later), 2 * ROUND)).max() < 1.0


@pytest.mark.parametrize(("room", "enough"), [(20, True), (5, False)])
def test_memory_is_bounded_and_where_it_does_not_do_that_is_said(
    monkeypatch: pytest.MonkeyPatch, without_drift: Mosaic, drifts: None, room: int, enough: bool
) -> None:
    frame_bytes = np.dtype(np.int16).itemsize * without_drift.grid.side**2
    monkeypatch.setattr(live_tracking, "KEYFRAME_BYTES", room * frame_bytes)
    look = Look(MosaicPlan())
    try:
        for first in range(0, 2 * ROUND, 10):
            look.add(truth().frames[first : first + 10])
            look.live.settle()
        assert look.live.state.rerenders == enough
        assert len(look.live._insertions[Mode.ELS].kept.frames) <= room + 10
        assert errors(look.rows()).max() < 0.5 or not enough
        assert alike(look.feed.canvases[0][0], without_drift) > (0.99 if enough else 0.7)
    finally:
        look.feed.close()
        look.live.close()


def test_what_goes_wrong_in_closing_is_said_with_the_next_frame(looks: Look, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise DeviceError("2 MB of shared memory are left", "clear the mosaic")

    monkeypatch.setattr(Mosaic, "replace_tile", full)
    monkeypatch.setattr(closing, "DISPLACEMENT_LIMIT_AT_REST_PX", 0.0)
    looks.add(truth().frames[: ROUND + AGAIN])
    looks.live.settle()
    with pytest.raises(DeviceError, match="shared memory"):
        looks.add(truth().frames[ROUND + AGAIN :])
