from __future__ import annotations

import pytest

from benchmarks.studies.drift import drift


def test_the_end_of_a_track_is_where_it_belongs() -> None:
    """Within a ten-thousandth of the path as frames come, and once loops are closed."""
    found = drift("fibres", back=True, frames=118)  # twice round
    assert found.path_px == pytest.approx(117 * 8000 / 240 / 1.33 * 1.05, rel=0.05)
    assert found.tracked == 1.0
    assert max(found.alone_percent, found.live_percent, found.graph_percent) < 0.01
