from __future__ import annotations

import pytest

from napari_elsplus.evaluation.drift import drift


def test_closing_loops_brings_the_end_of_the_track_to_where_it_belongs() -> None:
    found = drift("fibres", back=True, frames=118)  # twice round
    assert found.path_px == pytest.approx(117 * 8000 / 240 / 1.33 * 1.05, rel=0.05)
    assert found.tracked == 1.0
    assert found.graph_percent < 0.4 * found.live_percent < 0.04
