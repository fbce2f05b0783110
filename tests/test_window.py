"""The window that opens: what the manifest offers is in it."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from napari.utils.notifications import notification_manager
from npe2 import PluginManifest
from qtpy.QtCore import QSize, QTimer
from qtpy.QtWidgets import QDockWidget, QMessageBox

from napari_elsplus import _sample_data, _window
from napari_elsplus.processing.compilation import report_compilation
from napari_elsplus.widgets.shared.window import closing

pytestmark = pytest.mark.skipif(
    sys.platform.startswith("linux") and not {"DISPLAY", "WAYLAND_DISPLAY"} & set(os.environ),
    reason="no screen, and Qt would end the whole run: start pytest under xvfb-run",
)


@pytest.fixture
def manifest() -> PluginManifest:
    return PluginManifest.from_distribution("napari-elsplus")


def test_the_window_shows_what_the_manifest_offers(
    make_napari_viewer: Any, monkeypatch: pytest.MonkeyPatch, npe2pm: Any, manifest: PluginManifest, qtbot: Any
) -> None:
    monkeypatch.setattr(_sample_data, "FRAMES", 2)
    npe2pm.register(manifest)
    viewer = make_napari_viewer()
    _window.fill(viewer)
    panels = [widget.display_name for widget in manifest.contributions.widgets or ()]
    (dock,) = viewer.window.dock_widgets.values()
    tabs = [dock.tabs.tabText(index) for index in range(dock.tabs.count())]
    assert tabs == panels[1:]
    assert panels[0] in [one.windowTitle() for one in viewer.window._qt_window.findChildren(QDockWidget)]
    titles, *shown = [layer for layer in viewer.layers if layer.visible]
    assert [layer.name for layer in shown] == ["fibres LS", "fibres residual", "fibres ELS+"]
    assert list(titles.text.values) == ["LS", "residual", "ELS+"]
    assert viewer.layers.selection.active is shown[-1]
    qtbot.waitUntil(lambda: viewer.canvas.overlays.scale_bar.visible)
    visible = np.array([layer.extent.world[:, -2:] for layer in viewer.layers if layer.visible])
    assert viewer.scene.camera.center[-2:] == pytest.approx((visible.min((0, 1)) + visible.max((0, 1))) / 2)


def test_each_panel_is_in_the_menu_where_napari_keeps_its_kind(
    make_napari_viewer: Any, npe2pm: Any, manifest: PluginManifest
) -> None:
    npe2pm.register(manifest)
    bar = make_napari_viewer().window._qt_window.menuBar()
    menus = {action.text(): action.menu() for action in bar.actions()}
    for kind in ("&File/Acquire", "&Layers/Visualize", "&Layers/Measure", "&Layers/Register"):
        top, name = kind.split("/")
        (menu,) = [action.menu() for action in menus[top].actions() if action.text() == name]
        menus[kind] = {action.text().removesuffix(" (ELS+ endomicroscopy)") for action in menu.actions()}
    assert menus["&File/Acquire"] >= {"Rig", "Live"}
    assert menus["&Layers/Visualize"] >= {"Compare"}
    assert menus["&Layers/Measure"] >= {"Axial response", "Quality"}
    assert menus["&Layers/Register"] >= {"Mosaic"}


def test_the_window_is_drawn_between_the_kernels_that_a_sample_compiles(qtbot: Any) -> None:
    """Before: it stood still for 13 s when the first sample after an installation was opened."""
    drawn: list[bool] = []
    before = len(notification_manager.records)
    with _sample_data.compilation_displayed():
        for kernel in ("align", "", "render", ""):
            QTimer.singleShot(0, lambda: drawn.append(True))
            report_compilation(kernel)
    assert len(drawn) == 4
    assert [one.message for one in notification_manager.records[before:]] == [_sample_data.COMPILING]


@pytest.mark.parametrize(
    ("screen", "window"),
    [((1280, 800), (1280, 800)), ((1600, 1000), (1440, 900)), ((2560, 1440), (2176, 1224)), ((1366, 768), (1366, 768))],
)
def test_the_first_window_takes_all_of_a_small_screen(screen: tuple[int, int], window: tuple[int, int]) -> None:
    """Before: on 1280 x 800 a third of the window was left for the images."""
    assert _window.first_size(QSize(*screen)) == QSize(*window)


@pytest.fixture
def _handlers() -> Iterator[None]:
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.usefixtures("_handlers")
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signals")
@pytest.mark.parametrize("open_question", [False, True])
def test_a_signal_closes_the_window_without_a_question(
    make_napari_viewer: Any, qtbot: Any, monkeypatch: pytest.MonkeyPatch, open_question: bool
) -> None:
    """Before: a calibration that was not saved kept the window open, and the galvo scanning."""
    viewer = make_napari_viewer()
    asked: list[str] = []
    monkeypatch.setattr(closing, "confirm", lambda _, question: (asked.append(question), False)[1])
    _, panel = viewer.window.add_plugin_dock_widget(_window.PLUGIN, "Calibration")
    monkeypatch.setattr(panel._window_end, "_unsaved", lambda: "The calibration was not saved. Discard it?")
    viewer.window._qt_window.show()
    timer = _window.close_on_signals(viewer)
    if open_question:
        QTimer.singleShot(200, lambda: os.kill(os.getpid(), signal.SIGTERM))
        QMessageBox.question(viewer.window._qt_window, "Replace", "Replace it?")  # returns when it is closed
    else:
        os.kill(os.getpid(), signal.SIGTERM)
    qtbot.waitUntil(lambda: not hasattr(viewer.window, "_qt_window"), timeout=60_000)
    timer.stop()
    assert not asked
