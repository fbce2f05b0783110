"""A track as columns says what its points said, however it was written, moved or lost."""

from __future__ import annotations

import numpy as np
import pytest

from napari_elsplus.io import TrackPoint, TrackTable, read_track, write_track
from napari_elsplus.io.tables.track_table import ROW, packed

STATES = ("tracked", "tracked", "predicted", "lost")


def point(frame: int) -> TrackPoint:
    return TrackPoint(
        frame, frame / 240, frame // 700, 1.5 * frame, 2.5, 3.0 * frame, 5.0, 0.9, 0.01, STATES[frame % 4]
    )


def test_points_come_back_as_they_were_and_survive_their_file(tmp_path) -> None:
    points = [point(k) for k in range(2500)]
    table = TrackTable()
    for one in points[:1500]:
        table.append(one)
    table.write(1500, np.array([packed(one) for one in points[1500:]], ROW))
    assert list(table) == points
    assert table[-3:] == points[-3:]
    assert table[700] == points[700]
    with pytest.raises(IndexError):
        table[2500]
    assert table.counts == {"tracked": 1250, "predicted": 625, "lost": 625}
    write_track(tmp_path / "t.csv", table)
    assert read_track(tmp_path / "t.csv") == points


def test_rows_that_are_written_over_and_lost_are_counted_once() -> None:
    table = TrackTable(point(k) for k in range(1400))
    rows = table.columns[600:900].copy()
    rows["state"] = 0
    table.write(600, rows)
    assert len(table) == 1400
    assert table.counts == {"tracked": 850, "predicted": 275, "lost": 275}
    assert [row.state for row in table[600:900]] == ["tracked"] * 300
    table.lose(1)
    assert table.counts == {
        state: [row.state for row in table].count(state) for state in ("tracked", "predicted", "lost")
    }
    assert np.isnan(table[-1].row_px)
    assert table[699].row_px == 1.5 * 699
