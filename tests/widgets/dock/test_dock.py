"""The ELS+ dock: every panel as a tab of one dock, with a common status line."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from napari.settings import get_settings
from npe2 import PluginManifest
from qtpy.QtCore import QSize
from qtpy.QtWidgets import QPushButton, QScrollArea, QWidget

from napari_elsplus._problems import notify_errors, problems
from napari_elsplus.acquisition.engine.status import Settings
from napari_elsplus.errors import InputError
from napari_elsplus.widgets.dock.panel import FIRST, PANELS
from napari_elsplus.widgets.shared.panel import find_panel
from pairs import write_pair

PLUGIN = "napari-elsplus"
LAPTOPS = ((1280, 800), (1366, 768))


@pytest.fixture
def viewer(small_engine, make_napari_viewer_proxy):
    return make_napari_viewer_proxy()


@pytest.fixture
def dock(viewer, qtbot):
    """The dock, once every tab is built."""
    _, dock = viewer.window.add_plugin_dock_widget(PLUGIN, "ELS+")
    qtbot.waitUntil(lambda: all(tab.built for tab in dock.by_title.values()), timeout=30_000)
    return dock


def panel(dock, title):
    return dock.by_title[title].panel


def test_its_tabs_are_the_manifests_other_widgets():
    widgets = PluginManifest.from_distribution(PLUGIN).contributions.widgets or ()
    commands = {c.id: c.python_name for c in PluginManifest.from_distribution(PLUGIN).contributions.commands or ()}
    declared = [(widget.display_name, commands[widget.command]) for widget in widgets]
    assert declared == [("ELS+", "napari_elsplus.widgets.dock.panel:ElsPlusDock"), *map(tuple, PANELS)]


def test_no_panel_imports_matplotlib_before_something_is_drawn_for_a_file():
    """Its import takes a second or two, in which a window that waits for it is frozen."""
    code = (
        "import sys; from napari_elsplus.widgets.dock.panel import PANELS; [kind.load() for kind in PANELS];"
        "print('matplotlib' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def test_every_tab_has_whole_words_and_a_panel_in_a_scroll_area(dock):
    bar = dock.tabs.tabBar()
    assert dock.tabs.tabText(dock.tabs.currentIndex()) == FIRST
    assert [bar.tabText(index) for index in range(bar.count())] == [kind.title for kind in PANELS]
    for index in range(bar.count()):
        assert bar.tabRect(index).width() >= bar.fontMetrics().horizontalAdvance(bar.tabText(index))
    for title, tab in dock.by_title.items():
        assert panel(dock, title).findChild(QScrollArea) is not None, title
        assert type(panel(dock, title)) is tab.kind.load()


@pytest.mark.parametrize("size", LAPTOPS)
def test_it_fits_the_window_of_a_laptop(viewer, dock, qtbot, size):
    viewer.window.show()
    viewer.window.resize(*size)
    window = dock.window()
    qtbot.waitUntil(lambda: (window.width(), window.height()) == size, timeout=60_000)
    assert dock.minimumSizeHint().height() <= 400
    assert dock.minimumSizeHint().width() < size[0] / 2
    for title, tab in dock.by_title.items():
        dock.show_tab(title)
        scroll = tab.findChild(QScrollArea)
        assert scroll.viewport().width() >= scroll.widget().minimumSizeHint().width(), title


@pytest.mark.parametrize("font_pt", [9, 13, 18])
def test_the_window_fits_a_laptop_with_fonts_of_any_size(viewer, dock, qtbot, font_pt):
    """Before: with images open, the window was 1325 pixels wide with napari's font of 13 points."""
    get_settings().appearance.font_size = font_pt
    viewer.add_image(np.zeros((20, 60, 60), np.uint8))
    viewer.window.show()
    viewer.window.resize(1280, 800)
    window = dock.window()
    bar = dock.tabs.tabBar()
    qtbot.waitUntil(lambda: bar.fontMetrics().height() > font_pt, timeout=10_000)
    for title, tab in dock.by_title.items():
        dock.show_tab(title)
        qtbot.wait(50)
        assert dock.minimumSizeHint().width() <= 532, title
        scroll = tab.findChild(QScrollArea)
        if font_pt <= 13:
            assert window.minimumSizeHint().width() <= 1280, title
            assert scroll.horizontalScrollBar().maximum() == 0, title
        else:
            assert scroll.horizontalScrollBar().maximum() > 0 or scroll.widget().minimumSizeHint().width() < 525


def test_on_a_screen_of_half_a_laptop_panels_scroll_and_what_saves_and_starts_is_in_view(viewer, qtbot, monkeypatch):
    """Before: 1600 x 1000 pixels scaled by 2 showed the left half of each panel, and Compare's Save not at all."""
    monkeypatch.setattr(QWidget, "screen", lambda _: SimpleNamespace(availableSize=lambda: QSize(800, 500)))
    _, dock = viewer.window.add_plugin_dock_widget(PLUGIN, "ELS+")
    qtbot.waitUntil(lambda: all(tab.built for tab in dock.by_title.values()), timeout=30_000)
    viewer.window.show()
    viewer.window.resize(800, 500)
    wanted = {"Live": "Start", "Mosaic": "Save...", "Compare": "Save figure...", "Axial response": "Save..."}
    for title in dock.by_title:
        dock.show_tab(title)
        qtbot.wait(50)
        assert dock.window().minimumSizeHint().width() <= 800, title
        scroll = panel(dock, title).findChild(QScrollArea)
        assert scroll.widget().width() - scroll.viewport().width() == scroll.horizontalScrollBar().maximum()
        texts = {button.text(): button for button in panel(dock, title).findChildren(QPushButton)}
        if title in wanted:
            assert not texts[wanted[title]].visibleRegion().isEmpty(), title


def test_a_panel_in_a_dock_of_its_own_beside_the_others_fits_the_window_of_a_laptop(viewer, dock, qtbot):
    """Before: it did not scroll, and the window grew beyond the screen."""
    viewer.window.show()
    viewer.window.resize(1280, 800)
    window = dock.window()
    for kind in PANELS:
        viewer.window.add_plugin_dock_widget(PLUGIN, kind.title)
        qtbot.wait(50)
        assert window.minimumSizeHint().height() <= 800, kind.title
        dock.by_title[kind.title].take_panel()
        assert panel(dock, kind.title) is not None


def test_a_panel_of_the_menu_is_the_one_of_the_tab_and_comes_back_with_its_state(viewer, dock, qtbot):
    live = panel(dock, "Live")
    live.form.average.value = 7
    _, from_menu = viewer.window.add_plugin_dock_widget(PLUGIN, "Live")
    assert from_menu is live
    assert panel(dock, "Live") is None
    assert live.connection is dock.connection
    dock.by_title["Live"].take_panel()
    assert panel(dock, "Live") is live
    assert live.form.average.value == 7
    assert list(viewer.window.dock_widgets) == [f"ELS+ ({PLUGIN})"]


def test_a_panel_whose_own_dock_was_closed_is_made_anew_in_its_tab(viewer, dock):
    own, live = viewer.window.add_plugin_dock_widget(PLUGIN, "Live")
    viewer.window.remove_dock_widget(own)
    assert find_panel(type(live), viewer) is None
    dock.show_tab("Live")
    assert panel(dock, "Live") not in (None, live)


def test_a_panel_that_was_there_first_stays_in_its_own_dock(viewer, qtbot):
    _, live = viewer.window.add_plugin_dock_widget(PLUGIN, "Live")
    _, dock = viewer.window.add_plugin_dock_widget(PLUGIN, "ELS+")
    qtbot.waitUntil(lambda: all(tab.built for tab in dock.by_title.values()), timeout=30_000)
    assert panel(dock, "Live") is None
    assert find_panel(type(live), viewer) is live


def test_all_panels_share_one_engine_that_ends_with_the_dock(viewer, dock, small_engine):
    panel(dock, "Rig").connection.connect("simulated", Settings("240hz", frame_rate_hz=100.0))
    assert len(small_engine) == 1
    assert {id(panel(dock, title).connection) for title in ("Rig", "Calibration", "Live", "Mosaic")} == {
        id(dock.connection)
    }
    viewer.window.remove_dock_widget("all")  # the fixture waits until the process has ended
    assert dock.connection.client is None


def test_the_status_line_names_rig_stream_and_calibration(dock, qtbot):
    state = dock.status_line.state
    assert "no rig connected" in state.text()
    assert "active calibration: none" in state.text()
    dock.connection.connect("simulated", Settings("240hz", frame_rate_hz=100.0))
    qtbot.waitUntil(lambda: "<b>simulated</b>: connected" in state.text(), timeout=60_000)


def test_a_file_that_cannot_be_opened_stays_named_until_another_is_opened(dock, viewer, tmp_path):
    """Before: napari's notification alone, which cuts the remedy off and fades."""
    path, shown = tmp_path / "empty.tif", dock.status_line.problem
    path.touch()
    viewer.open(str(path), plugin="napari-elsplus")
    dock.refresh()
    assert "empty.tif is empty: copy or record it again" in shown.text()
    viewer.open(str(write_pair(tmp_path)), plugin="napari-elsplus")
    dock.refresh()
    assert shown.isHidden()


def test_an_error_stays_with_its_remedy_until_the_panels_next_action_succeeds(dock, tmp_path):
    shown = dock.status_line.problem
    compare, rig = panel(dock, "Compare"), panel(dock, "Rig")
    compare.copy_script()
    dock.refresh()
    assert "no recording with a calibration is open: open one" in shown.text()
    assert not shown.isHidden()
    rig.load(Path(tmp_path, "absent.json"))
    dock.refresh()
    assert "absent.json" in shown.text()
    with notify_errors(rig):
        pass
    dock.refresh()
    assert "no recording" in shown.text()
    dock.status_line.dismiss.click()
    assert shown.isHidden()
    with notify_errors(compare):
        raise InputError("a second problem", "do that")
    dock.refresh()
    assert "a second problem: do that" in shown.text()
    problems.dismiss()
