"""What is looked at of an engine stays when that is gone, however far it was copied."""

from __future__ import annotations

import pytest

from napari_elsplus.acquisition.mosaic import feed as mosaic_feed
from napari_elsplus.acquisition.mosaic.board import MosaicBoard
from napari_elsplus.acquisition.mosaic.board_tables import Tables
from napari_elsplus.acquisition.mosaic.tracking import TrackState
from napari_elsplus.io import TrackPoint
from napari_elsplus.viewing.mosaic.live import LiveMosaicView
from napari_elsplus.workflows.mosaic_plan import MosaicPlan


@pytest.mark.parametrize("whole", [False, True])
def test_a_long_track_is_kept_as_far_as_it_was_copied(monkeypatch: pytest.MonkeyPatch, whole: bool) -> None:
    monkeypatch.setattr(Tables, "rows_together", 64)
    monkeypatch.setattr(mosaic_feed, "MAX_ROWS_PER_UPDATE", 100)
    board = MosaicBoard()
    for k in range(500):
        board.append(TrackPoint(k, k / 240, 0, 1.5 * k, 2.0, 3.0 * k, 4.0, 0.9, 0.01, "tracked"))
    live = LiveMosaicView(TrackState(MosaicPlan(), board.name, 2.0, 100.0, {}, None), None)
    assert live.update(all_rows=whole)
    assert len(live.rows) == (500 if whole else 100)
    board.close()
    assert not live.update(all_rows=True)
    live.close()
    assert [row.frame for row in live.rows] == list(range(len(live.rows)))
    assert not live.follows
    assert not live.update()
