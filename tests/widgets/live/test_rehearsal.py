"""The Rig panel's button that rehearses faults, pressed as a user does."""

from __future__ import annotations

import pytest

from napari_elsplus.diagnosis.rehearsal.rehearse import faults

PLUGIN = "napari-elsplus"


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_fault_is_rehearsed_in_the_window_and_shown_in_a_table(
    make_napari_viewer_proxy, qtbot, small_engine, monkeypatch
) -> None:
    chosen = faults(["strobe-lost"])
    monkeypatch.setattr("napari_elsplus.diagnosis.rehearsal.rehearse.faults", lambda: chosen)
    _, panel = make_napari_viewer_proxy().window.add_plugin_dock_widget(PLUGIN, "Rig")
    rehearsal = panel.rehearsal
    assert rehearsal.button.enabled
    rehearsal.button.native.click()
    assert not rehearsal.button.enabled
    qtbot.waitUntil(lambda: not rehearsal.work.busy, timeout=90_000)
    qtbot.waitUntil(lambda: rehearsal.button.enabled)
    cells = [rehearsal.table.item(0, column).text() for column in range(rehearsal.table.columnCount())]
    assert cells[:2] == ["strobe-lost", "yes"], cells
    assert float(cells[2]) < 0.5
    assert "strobe" in cells[-1]
    rehearsal.table.window().close()


def test_there_is_no_rehearsal_while_a_rig_is_connected(make_napari_viewer_proxy, qtbot, small_engine) -> None:
    _, panel = make_napari_viewer_proxy().window.add_plugin_dock_widget(PLUGIN, "Rig")
    panel.connect.native.click()
    qtbot.waitUntil(lambda: panel.connection.client is not None and not panel.requests.busy, timeout=60_000)
    panel.refresh()
    assert not panel.rehearsal.button.enabled
    assert "Disconnect first" in panel.rehearsal.button.tooltip
    panel.connect.native.click()
    qtbot.waitUntil(lambda: panel.connection.client is None and not panel.requests.busy, timeout=60_000)
