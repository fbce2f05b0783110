from __future__ import annotations

import numpy as np
import pytest

from napari_elsplus.io import TrackPoint
from napari_elsplus.viewing.track import BEGINS, LOST, MOST_LINES, PREDICTED, TrackDrawing, speed_of

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
    drawing = TrackDrawing(2.0)
    rows = track()
    for k in range(len(rows) + 1):
        drawing.add(rows[:k])
    assert not drawing.add(rows)
    drawn = drawing.drawing(lambda segment: (100 * segment, 0))
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
    assert drawing.counts == {"tracked": 9, "predicted": 1, "lost": 2}
    assert drawing.segments == 2


def test_a_still_probe_costs_no_lines_and_its_worst_score_is_kept() -> None:
    drawing = TrackDrawing(1.0)
    rows = [point(k, 0, 0.01 * k, score=0.3 if k == 50 else 0.9) for k in range(300)]
    drawing.add(rows)
    drawn = drawing.drawing(lambda _: (0, 0))
    assert len(drawn.lines) == 1
    assert drawn.score.tolist() == [0.3]


def test_a_long_track_is_thinned_and_still_whole() -> None:
    drawing = TrackDrawing(1.0)
    drawing.add([point(k, 0, 3.0 * k, score=0.2 if k == 7 else 0.9) for k in range(MOST_LINES + 2)])
    drawn = drawing.drawing(lambda _: (0, 0))
    assert len(drawn.lines) <= MOST_LINES / 2 + 1
    np.testing.assert_allclose(drawn.lines[1:, 0], drawn.lines[:-1].sum(axis=1))
    assert drawn.lines[:, 1, 1].sum() == 3.0 * (MOST_LINES + 1)
    assert drawn.score.min() == 0.2


def test_speed_is_what_the_last_frames_say() -> None:
    speed = speed_of(track(), 100.0, 2.0)
    assert speed.px_per_frame == pytest.approx(10)
    assert speed.share == pytest.approx(0.1)
    assert speed.um_per_s == pytest.approx(10 * 2 * 100)
    assert speed.fastest_um_per_s == pytest.approx(20_000)
    assert speed.tracked == pytest.approx(9 / 12)
    assert np.isnan(speed_of([point(0, 0, 0)], 100.0).share)
    assert np.isnan(speed_of([], 100.0).px_per_frame)
