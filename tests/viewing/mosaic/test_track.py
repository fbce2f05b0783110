from __future__ import annotations

import numpy as np
import pytest

from napari_elsplus.io import TrackPoint, TrackTable
from napari_elsplus.io.tables.track_table import ROW
from napari_elsplus.viewing.mosaic import track as viewed
from napari_elsplus.viewing.mosaic.track import BEGINS, LOST, MAX_LINES, MAX_MARKS, PREDICTED, TrackDrawing, probe_speed

NAN = float("nan")


def point(
    frame: int, row: float, col: float, state: str = "tracked", segment: int = 0, score: float = 0.9
) -> TrackPoint:
    return TrackPoint(frame, frame / 100, segment, row, col, 2 * row, 2 * col, score, 0.01, state)


def track() -> list[TrackPoint]:
    first = [point(k, 0, 10.0 * k, score=0.9 if k != 2 else 0.4) for k in range(5)]
    gap = [point(5, 0, 50, "predicted"), point(6, 0, 60)]
    lost = [point(k, NAN, NAN, "lost") for k in (7, 8)]
    second = [point(9 + k, 10.0 * k, 0, segment=1) for k in range(3)]
    return [*first, *gap, *lost, *second]


def test_lines_follow_tracked_frames_only_and_marks_say_the_rest() -> None:
    table = TrackTable()
    drawing = TrackDrawing(table, 2.0)
    for row in track():
        table.append(row)
        assert drawing.add()
    assert not drawing.add()
    drawn = drawing.geometry(lambda segment: (100 * segment, 0))
    assert drawn.lines[:, 0].tolist() == [[0, 0], [0, 5], [0, 10], [0, 15], [100, 0], [105, 0]]
    assert drawn.lines[:, 1].tolist() == [[0, 5]] * 4 + [[5, 0]] * 2
    assert drawn.score.tolist() == [0.9, 0.4, 0.9, 0.9, 0.9, 0.9]
    assert drawn.segment.tolist() == [0, 0, 0, 0, 1, 1]
    assert list(zip(drawn.marks.tolist(), drawn.kinds, drawn.labels, strict=True)) == [
        ([0, 0], BEGINS, "1"),
        ([0, 25], PREDICTED, ""),
        ([0, 30], LOST, ""),
        ([100, 0], BEGINS, "2"),
    ]
    assert table.counts == {"tracked": 9, "predicted": 1, "lost": 2}
    assert drawing.segments == 2


def drawn_at_once(rows: list[TrackPoint]) -> TrackDrawing:
    drawing = TrackDrawing(TrackTable(rows), 1.0)
    while drawing.behind:
        drawing.add()
    return drawing


def test_a_still_probe_costs_no_lines_and_the_worst_score_along_a_line_is_kept() -> None:
    rows = [point(k, 0, 0.01 * k, score=0.3 if k == 250 else 0.9) for k in range(300)]
    drawn = drawn_at_once(rows).geometry(lambda _: (0, 0))
    assert drawn.lines.sum(axis=1)[:, 1] == pytest.approx([2.99])  # to where the probe is
    assert drawn.score.tolist() == [0.3]


def test_a_long_track_is_thinned_and_still_whole() -> None:
    rows = [point(k, 0, 3.0 * k, score=0.2 if k == 70 else 0.9) for k in range(3 * MAX_LINES)]
    drawn = drawn_at_once(rows).geometry(lambda _: (0, 0))
    assert MAX_LINES / 4 < len(drawn.lines) <= MAX_LINES + 1
    np.testing.assert_allclose(drawn.lines[1:, 0], drawn.lines[:-1].sum(axis=1))
    assert drawn.lines[0, 0, 1] < 16
    assert drawn.lines[-1].sum(axis=0)[1] == 3.0 * (3 * MAX_LINES - 1)
    assert drawn.score.min() == 0.2


def test_of_many_rounds_over_one_place_the_newest_are_drawn_whole_and_the_rest_shows_where_the_probe_was() -> None:
    frames = np.arange(120_000)
    row, col = 900 * np.sin(frames / 200), 900 * np.sin(1.37 * frames / 200)
    rows = TrackTable()
    rows.write(0, np.zeros(len(frames), ROW))
    rows.columns["row_px"], rows.columns["col_px"], rows.columns["score"] = row, col, 0.9
    drawing = TrackDrawing(rows, 1.0)
    while drawing.behind:
        drawing.add()
    drawn = drawing.geometry(lambda _: (0, 0))
    assert MAX_LINES / 8 < len(drawn.lines) <= MAX_LINES + 1
    assert np.hypot(*drawn.lines[:, 1].T).max() < 3 * 64
    along = (drawn.lines[:, :1] + np.linspace(0, 1, 20)[:, None] * drawn.lines[:, 1:]).reshape(-1, 2)
    near = [np.hypot(*(along - (row[k], col[k])).T).min() for k in range(0, len(frames), 501)]
    assert max(near) < 140  # wherever it was there is a line
    newest = [np.hypot(*(along - (row[k], col[k])).T).min() for k in range(len(frames) - 1000, len(frames), 10)]
    assert max(newest) < 10


def test_frames_that_are_put_elsewhere_are_drawn_there_without_being_looked_at_again() -> None:
    table = TrackTable(track())
    drawing = TrackDrawing(table, 2.0)
    drawing.add()
    table.columns["row_px"] += 8
    table.columns["segment"] = 0  # the second segment was found to lie in the first
    drawn = drawing.geometry(lambda segment: (100 * segment, 0))
    assert drawn.lines[:, 0].tolist() == [[4, 0], [4, 5], [4, 10], [4, 15], [4, 0], [9, 0]]
    assert drawn.lines[:, 1].tolist() == [[0, 5]] * 4 + [[5, 0]] * 2
    assert drawn.kinds.tolist() == [BEGINS, PREDICTED, LOST]
    assert drawing.segments == 1
    table.lose(0)
    drawn = drawing.geometry(lambda _: (0, 0))
    assert (len(drawn.lines), len(drawn.marks), drawing.segments) == (0, 0, 0)


def test_many_marks_are_thinned_to_those_that_lie_apart() -> None:
    rows = [point(k, 40.0 * (k // 1000), k % 1000, "tracked" if k % 4 else "predicted") for k in range(20_000)]
    drawn = drawn_at_once(rows).geometry(lambda _: (0, 0))
    assert MAX_MARKS / 8 < len(drawn.marks) <= MAX_MARKS + 1
    assert drawn.marks[drawn.kinds == PREDICTED].min(axis=0) == pytest.approx((0, 0), abs=130)
    assert drawn.marks[drawn.kinds == PREDICTED].max(axis=0) == pytest.approx((760, 996), abs=130)


def test_rows_that_come_all_at_once_are_taken_in_piece_by_piece(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(viewed, "ROWS_AT_ONCE", 3)
    drawing = TrackDrawing(TrackTable(track()), 2.0)
    steps = 0
    while drawing.behind:
        drawing.add()
        steps += 1
    whole = TrackDrawing(TrackTable(track()), 2.0)
    monkeypatch.undo()
    whole.add()
    assert steps == 4
    for one, other in zip(drawing.geometry(lambda _: (0, 0)), whole.geometry(lambda _: (0, 0)), strict=True):
        np.testing.assert_array_equal(one, other)


def test_speed_is_what_the_last_frames_say() -> None:
    speed = probe_speed(track(), 100.0, 2.0)
    assert speed.px_per_frame == pytest.approx(10)
    assert speed.share == pytest.approx(0.1)
    assert speed.um_per_s == pytest.approx(10 * 2 * 100)
    assert speed.max_um_per_s == pytest.approx(20_000)
    assert speed.tracked == pytest.approx(9 / 12)
    assert np.isnan(probe_speed([point(0, 0, 0)], 100.0).share)
    assert np.isnan(probe_speed([], 100.0).px_per_frame)
    assert np.isnan(probe_speed([], 100.0).tracked)
