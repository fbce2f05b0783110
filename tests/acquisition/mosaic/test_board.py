from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from napari_elsplus.acquisition.mosaic import feed as mosaic_feed
from napari_elsplus.acquisition.mosaic.board import MosaicBoard
from napari_elsplus.acquisition.mosaic.board_tables import CHANGES, Tables
from napari_elsplus.acquisition.mosaic.feed import MosaicFeed
from napari_elsplus.acquisition.streaming import shared_memory as shared
from napari_elsplus.errors import DeviceError
from napari_elsplus.io import TrackPoint
from napari_elsplus.processing.mosaicing.mosaic import Insertion, Mosaic
from napari_elsplus.processing.tracking.front_end.grid import Grid
from napari_elsplus.processing.tracking.motion.rolling_shutter import RollingShutter

GRID = Grid(120, 1, (0, 0), (59.5, 59.5), 116.0, RollingShutter(150.0))
LOOK = """
import sys
from napari_elsplus.acquisition.mosaic.feed import MosaicFeed
feed = MosaicFeed(sys.argv[1])
feed.update()
print(len(feed.rows), float(feed.canvases[0][0].read()[0].max()))
feed.close()
"""


def point(frame: int, segment: int = 0, state: str = "tracked") -> TrackPoint:
    return TrackPoint(frame, frame / 240, segment, 1.5 * frame, 2.5, 3.0 * frame, 5.0, 0.9, 0.01, state)


class Scribe:
    """Draws and tells as the live track does."""

    def __init__(self, board: MosaicBoard, insertion: Insertion = Insertion.DEAD_LEAF) -> None:
        self.board, self.insertion = board, insertion
        self.mosaics: dict[int, Mosaic] = {}
        self.frames = 0

    def draw(self, row: float, col: float, segment: int = 0) -> None:
        if segment not in self.mosaics:
            self.mosaics[segment] = Mosaic(GRID, self.insertion, store=self.board.new_store(segment))
        mosaic = self.mosaics[segment]
        image = np.random.default_rng(self.frames).random((120, 120)).astype(np.float32) + 1
        mosaic.insert(image, row, col)
        dirty = mosaic.take_dirty()
        assert dirty is not None
        self.board.changed(segment, dirty)
        self.board.append(point(self.frames, segment))
        self.frames += 1

    def drop(self, segment: int) -> None:
        del self.mosaics[segment]
        self.board.drop(segment)


@pytest.fixture
def scribe(request: pytest.FixtureRequest) -> Iterator[Scribe]:
    board = MosaicBoard()
    scribe = Scribe(board, getattr(request, "param", Insertion.DEAD_LEAF))
    yield scribe
    scribe.mosaics.clear()
    board.close()
    assert not list(Path("/dev/shm").glob(f"{board.name}*"))


def same(feed: MosaicFeed, scribe: Scribe) -> None:
    assert set(feed.canvases.get(0, {})) == set(scribe.mosaics)
    for segment, mosaic in scribe.mosaics.items():
        mirror = feed.canvases[0][segment]
        for theirs, ours in zip(mosaic.read(), mirror.read(mosaic.extent), strict=True):
            np.testing.assert_array_equal(theirs, ours)


@pytest.mark.parametrize("scribe", [how for how in Insertion if how.while_acquiring], indirect=True)
def test_who_looks_has_the_same_mosaic_and_copies_only_what_changed(scribe: Scribe) -> None:
    feed = MosaicFeed(scribe.board.name, blended=scribe.insertion is Insertion.FEATHERED)
    try:
        assert not feed.update()
        for k in range(40):
            scribe.draw(13.3 * k, -40.7 * k, k // 25)
            if k % 7 == 0:
                assert feed.update()
                same(feed, scribe)
        feed.update()
        for segment, mosaic in scribe.mosaics.items():
            assert mosaic.extent.intersection(feed.canvases[0][segment].extent) == feed.canvases[0][segment].extent
        assert not feed.update()
        for canvas in feed.canvases[0].values():
            canvas.take_dirty()
        scribe.draw(0.0, 0.0, 1)
        feed.update()
        dirty = feed.canvases[0][1].take_dirty()
        assert dirty is not None
        assert max(dirty.shape) < 120
        assert feed.canvases[0][0].take_dirty() is None
        same(feed, scribe)
        assert list(feed.rows) == [point(k, 0 if k < 25 else 1) for k in range(41)]
    finally:
        feed.close()


def test_who_has_not_looked_for_long_gets_everything(scribe: Scribe, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Tables, "rows_together", 64)
    feed = MosaicFeed(scribe.board.name)
    try:
        scribe.draw(0.0, 0.0)
        feed.update()
        for k in range(5):
            scribe.draw(700.0 * k, 0.0)
        for k in range(CHANGES):
            scribe.board.changed(0, scribe.mosaics[0].extent._replace(bottom=-30) if k else scribe.mosaics[0].extent)
        scribe.draw(-500.0, -500.0)
        for k in range(200):
            scribe.board.append(point(scribe.frames + k))
        feed.update()
        same(feed, scribe)
        assert len(feed.rows) == 207
    finally:
        feed.close()


def test_rows_that_belong_elsewhere_are_read_again_block_by_block(
    scribe: Scribe, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Tables, "rows_together", 64)
    monkeypatch.setattr(mosaic_feed, "MAX_ROWS_PER_UPDATE", 100)
    feed = MosaicFeed(scribe.board.name)
    board, rows = scribe.board, feed.rows
    try:
        for k in range(300):
            board.append(point(k))
        looks = 0
        while feed.update():
            looks += 1
        assert (len(rows), looks) == (300, 3)
        copied: list[int] = []
        write = rows.write
        monkeypatch.setattr(rows, "write", lambda first, fresh: (copied.append(first), write(first, fresh)))
        for block in board.blocks:
            place = np.array([point(k).row_px for k in range(block.start, block.stop)])
            moved = 7.0 if block.start in (64, 256) else 1e-4
            board.relocate(block, np.zeros(len(place), np.int64), place + moved, np.full(len(place), 2.5), 2.0)
        assert [feed.update() for _ in range(3)] == [True, True, False]
        assert sorted(copied) == [64, 256]  # the others do not move
        board.relocate(board.blocks[0], np.ones(64, np.int64), np.zeros(64), np.zeros(64), 2.0)
        feed.update()
        assert [(row.segment, row.row_px, row.row_um) for row in (rows[63], rows[64])] == [(1, 0, 0), (0, 103, 206)]
        with board._writing(board.blocks[0]) as block:
            block["row_px"] = 5.0
            board.append(point(300))
            feed.update()  # what is being written is left for the next look
            assert (rows[0].row_px, rows[-1].frame) == (0, 300)
        feed.update()
        assert rows[0].row_px == 5
        assert feed.rows is rows
    finally:
        feed.close()


def test_a_dropped_segment_is_gone_its_frames_are_lost_and_its_tiles_are_used_again(scribe: Scribe) -> None:
    feed = MosaicFeed(scribe.board.name)
    try:
        for k in range(20):
            scribe.draw(0.0, 200.0 * k, k // 10)
        feed.update()
        revision = feed.revision
        scribe.drop(1)
        feed.update()
        assert feed.revision != revision
        same(feed, scribe)
        assert [row.state for row in feed.rows] == ["tracked"] * 10 + ["lost"] * 10
        assert np.isnan(feed.rows[-1].row_px)
        for k in range(20):
            scribe.draw(300.0 * k, -90.0, 2)
            feed.update()
        same(feed, scribe)
    finally:
        feed.close()


def test_what_was_copied_outlives_the_board_and_another_process_sees_it(scribe: Scribe) -> None:
    scribe.draw(3.0, 4.0)
    done = subprocess.run(
        [sys.executable, "-c", LOOK, scribe.board.name], capture_output=True, text=True, timeout=600, check=True
    )
    count, brightest = done.stdout.split()
    image = scribe.mosaics[0].read()[0]
    assert (int(count), float(brightest)) == (1, float(image.max()))
    assert not done.stderr
    feed = MosaicFeed(scribe.board.name)
    feed.update()
    extent = scribe.mosaics[0].extent
    feed.close()
    scribe.mosaics.clear()
    np.testing.assert_array_equal(feed.canvases[0][0].read(extent)[0], image)


@pytest.mark.skipif(not Path("/dev/shm").is_dir(), reason="what is left is known on Linux only")
def test_full_shared_memory_is_an_error_and_no_crash(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shared, "_RESERVE_BYTES", 1 << 60)
    with pytest.raises(DeviceError, match="shared memory"):
        MosaicBoard()
