from __future__ import annotations

import pytest

from napari_elsplus.acquisition.engine.status import Settings
from napari_elsplus.io.settings import remember
from napari_elsplus.widgets.shared.rig_choice import remembered_settings


@pytest.mark.parametrize("value", [{"slit_rows": "three"}, {"frame_rate_hz": "fast"}, {"gain_db": [1]}, {"preset": 7}])
def test_remembered_settings_that_are_none_leave_the_defaults(tmp_path, monkeypatch, value) -> None:
    """Before: the panels of a rig did not open."""
    monkeypatch.setenv("ELSPLUS_CONFIG", str(tmp_path))
    remember("rig", **value)
    assert remembered_settings() == Settings()


def test_settings_are_remembered(tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("ELSPLUS_CONFIG", str(tmp_path))
    remember("rig", preset="120hz", slit_rows=5, frame_rate_hz=100, gain_db=2)
    assert remembered_settings() == Settings("120hz", 5, 100.0, 2.0)
