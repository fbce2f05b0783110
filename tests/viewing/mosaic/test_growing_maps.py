"""Maps of a track that comes in pieces, and is put elsewhere, are those of all its frames."""

from __future__ import annotations

import numpy as np
import pytest

from napari_elsplus.io import TrackPoint, TrackTable
from napari_elsplus.processing.mosaicing.coverage import Coverage
from napari_elsplus.processing.mosaicing.tiles import Rectangle
from napari_elsplus.viewing.mosaic import growing_maps
from napari_elsplus.viewing.mosaic.growing_maps import GrowingMaps

PART, RADIUS = Rectangle(-64, -64, 320, 448), 40.0
PLACES = {0: (0, 0), 1: (160, 8)}


def point(frame: int) -> TrackPoint:
    state = "lost" if frame % 10 == 9 else "tracked"
    return TrackPoint(frame, 0.0, frame // 60, 4.0 * (frame % 30), 5.0 * frame, 0.0, 0.0, 0.5 + frame / 400, 0.1, state)


def counted_at_once(rows: TrackTable, part: Rectangle) -> Coverage:
    coverage = Coverage(part, RADIUS)
    known = [row for row in rows if row.state == "tracked"]
    where = [(row.row_px / 2 + PLACES[row.segment][0], row.col_px / 2 + PLACES[row.segment][1]) for row in known]
    coverage.add(np.array(where), np.array([row.score for row in known]))
    return coverage


def same(one: Coverage | None, other: Coverage) -> bool:
    return (
        one is not None
        and np.array_equal(one.frames, other.frames)
        and np.allclose(one.quality, other.quality, equal_nan=True)
    )


def test_they_are_those_of_all_frames_however_these_come(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(growing_maps, "ROWS_AT_ONCE", 16)
    rows = TrackTable(point(k) for k in range(100))
    maps = GrowingMaps(rows, RADIUS, 2.0)
    for _ in range(7):
        assert maps.whole is None
        assert maps.behind(PART, PLACES)
        maps.add(PART, PLACES)
    first = counted_at_once(rows, PART)
    assert not maps.behind(PART, PLACES)
    assert same(maps.whole, first)
    assert first.frames.max() > 5
    rows.append(point(100))
    maps.add(PART, PLACES)
    assert same(maps.whole, counted_at_once(rows, PART))

    before = counted_at_once(rows, PART)
    moved = rows.columns[20:40].copy()
    moved["row_px"] += 100
    rows.write(20, moved)
    wider = Rectangle(-128, -64, 320, 448)
    for _ in range(6):
        assert maps.behind(wider, PLACES)
        maps.add(wider, PLACES)
        assert same(maps.whole, before)
    maps.add(wider, PLACES)
    assert same(maps.whole, counted_at_once(rows, wider))
    assert not same(maps.whole, before)
