"""Every control of every panel at its extremes while frames stream: no traceback, no thread dead."""

from __future__ import annotations

from napari.utils.notifications import ErrorNotification, notification_manager
from qtpy.QtWidgets import QAbstractSlider, QAbstractSpinBox, QCheckBox, QComboBox, QDoubleSpinBox, QSpinBox

from napari_elsplus.acquisition.engine.status import Settings
from pairs import write_pair
from small_rig import small_calibration

PLUGIN = "napari-elsplus"
PANELS = ("Rig", "Live", "Mosaic", "Calibration", "Compare", "Axial response", "Quality")
SLOW = Settings("240hz", frame_rate_hz=100.0)


def extremes(control):
    """The values of a control that are tried, and the function that sets one."""
    if isinstance(control, QComboBox):
        return range(control.count()), control.setCurrentIndex
    if isinstance(control, QCheckBox):
        return (not control.isChecked(), control.isChecked()), control.setChecked
    return (control.minimum(), control.maximum(), control.value()), control.setValue


def test_controls_at_their_extremes_leave_no_traceback_and_a_stream_that_runs(
    small_engine, make_napari_viewer_proxy, qtbot, tmp_path
):
    before = len(notification_manager.records)
    viewer = make_napari_viewer_proxy()
    viewer.open(str(write_pair(tmp_path)), plugin=PLUGIN)
    _, live = viewer.window.add_plugin_dock_widget(PLUGIN, "Live")
    client = live.connection.connect("simulated", SLOW)
    client.use(small_calibration()).result(60)
    for name in PANELS:
        if not client.status.live or client.status.camera_hz < 50:
            client.configure(SLOW).result(60)
            client.start().result(60)
        panel = live if name == "Live" else viewer.window.add_plugin_dock_widget(PLUGIN, name)[1]
        assert try_extremes(panel, qtbot) > 3, name
        assert client.died is None, name
        if not client.status.live:
            client.configure(SLOW).result(60)
            client.start().result(60)
        acquired = client.status.acquired
        qtbot.waitUntil(lambda acquired=acquired: client.status.acquired != acquired, timeout=30_000)
        records = notification_manager.records[before:]
        assert [r.message for r in records if isinstance(r, ErrorNotification)] == [], name
        broken = [r.message for r in records if "Traceback" in r.message or r.message.startswith("a thread")]
        assert broken == [], name


def try_extremes(panel, qtbot):
    """Set each control of a panel to its extremes, and return how many values were tried."""
    busy = lambda: any(  # noqa: E731
        getattr(getattr(panel, part, None), "busy", False) for part in ("requests", "work")
    )
    qtbot.waitUntil(lambda: not busy(), timeout=30_000)
    kinds = (QSpinBox, QDoubleSpinBox, QComboBox, QCheckBox, QAbstractSlider)
    controls = {control for kind in kinds for control in panel.findChildren(kind)}
    controls = [one for one in controls if not isinstance(one.parent(), QAbstractSpinBox | QComboBox)]
    tried = 0
    for control in controls:
        if not control.isEnabled() or type(control).__name__ == "QScrollBar":
            continue
        values, setter = extremes(control)
        for value in values:
            setter(value)
            qtbot.waitUntil(lambda: not busy(), timeout=30_000)
            tried += 1
    return tried
