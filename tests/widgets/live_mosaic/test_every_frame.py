"""A live mosaic from its begin to its end, with a row of the track for every frame."""

from __future__ import annotations

import numpy as np
import pytest

from napari_elsplus.io import read_track


def test_the_live_mosaic_grows_rests_is_undone_saved_and_cleared(viewer, panel, qtbot, go_live, tmp_path):
    go_live(viewer, panel, qtbot)
    layer = viewer.layers["mosaic LS"]
    qtbot.waitUntil(lambda: np.nan_to_num(layer.data[0]).max() > 50, timeout=30_000)
    assert layer.scale == pytest.approx([2.66, 2.66])
    assert panel.live
    qtbot.waitUntil(lambda: "mm/s (limit" in panel.form.speed.text, timeout=30_000)
    qtbot.waitUntil(lambda: panel.form.going_live.text == "Stop live" and panel.form.going_live.enabled, timeout=30_000)
    panel.save(tmp_path / "live.ome.tif")
    qtbot.waitUntil(lambda: not panel.work.busy and panel.form.going_live.enabled, timeout=30_000)
    rows = read_track(tmp_path / "live.track.csv")
    assert [row.frame for row in rows] == list(range(len(rows)))
    assert (tmp_path / "live.png").exists()

    panel.form.going_live.native.click()
    qtbot.waitUntil(lambda: not panel.live, timeout=30_000)
    assert panel.connection.client.status.live
    panel.undo()
    qtbot.waitUntil(lambda: not np.isfinite(layer.data[0]).any(), timeout=30_000)
    panel.form.clearing.native.click()
    qtbot.waitUntil(lambda: panel.connection.client.status.track is None, timeout=30_000)
    assert not [one.name for one in viewer.layers if one.name.startswith("mosaic")]
    go_live(viewer, panel, qtbot)
