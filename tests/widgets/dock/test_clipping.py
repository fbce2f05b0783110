"""No text of any panel is clipped, in the windows of a laptop and of a desk."""

from __future__ import annotations

import pytest
from napari.settings import get_settings
from qtpy.QtCore import QPoint
from qtpy.QtWidgets import QLabel, QProgressBar, QPushButton, QVBoxLayout, QWidget

from benchmarks.screens.__main__ import SIZES, THEMES
from benchmarks.screens.clipping import clipped_texts
from napari_elsplus.widgets.analysis.axial import MANUAL, SIMULATED
from napari_elsplus.widgets.dock.panel import PANELS

pytestmark = pytest.mark.checkout
PLUGIN = "napari-elsplus"


@pytest.fixture
def dock(small_engine, make_napari_viewer_proxy, qtbot):
    """The dock in a visible window, every tab built."""
    viewer = make_napari_viewer_proxy(show=True)
    _, dock = viewer.window.add_plugin_dock_widget(PLUGIN, "ELS+")
    qtbot.waitUntil(lambda: all(tab.built for tab in dock.by_title.values()), timeout=30_000)
    return dock


def test_the_measurement_finds_what_is_clipped(qtbot):
    panel = QWidget()
    qtbot.addWidget(panel)
    layout = QVBoxLayout(panel)
    narrow, whole, wrapped = QPushButton("a button with a long name"), QPushButton("short"), QLabel("many words " * 9)
    bar = QProgressBar()
    bar.setFormat("a step with a long name: %p %")
    bar.setValue(1)
    bar.setFixedWidth(60)
    for widget in (narrow, whole, wrapped, bar):
        layout.addWidget(widget)
    narrow.setFixedWidth(40)
    wrapped.setWordWrap(True)
    wrapped.setFixedSize(100, 20)
    panel.show()
    found = clipped_texts(panel)
    assert len(found) == 3
    assert all(any(one in text for text in found) for one in ("a button with", "a step with"))


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("theme", THEMES)
def test_no_text_of_any_panel_is_clipped(dock, qtbot, size, theme):
    viewer = dock.viewer
    viewer.theme = theme
    viewer.window.resize(*size)
    window = dock.window()
    qtbot.waitUntil(lambda: window.width() == size[0], timeout=60_000)
    clipped, places = [], set()
    for kind in PANELS:
        dock.show_tab(kind.title)
        panel = dock.by_title[kind.title].panel
        qtbot.waitUntil(panel.isVisible, timeout=60_000)
        choices = {"Calibration": panel.form.steps if kind.title == "Calibration" else {}, "Axial response": SCANS}
        for choice in choices.get(kind.title, [""]):
            if kind.title == "Calibration":
                panel.choose(choice)
            elif kind.title == "Axial response":
                panel.source.value = choice
            qtbot.wait(50)
            clipped += [f"{kind.title} {choice}: {text}" for text in clipped_texts(dock)]
            if kind.title == "Calibration":
                buttons = panel.form.measure, panel.form.accept, panel.form.next_step
                places.add(tuple((button.x(), button.y()) for button in buttons))
    assert clipped == []
    assert len(places) == 1, "buttons keep their places from step to step"


@pytest.mark.parametrize("font_pt", [9, 14])
def test_the_tabs_begin_below_the_title_of_the_dock(dock, qtbot, font_pt):
    """Before: with napari's font of 14 points the title covered a third of them."""
    get_settings().appearance.font_size = font_pt
    title = dock.parentWidget().titleBarWidget()
    bar = dock.tabs.tabBar()

    def beside() -> bool:
        title_end = title.mapToGlobal(title.rect().bottomLeft()).y() + 1
        return title.height() > font_pt and bar.mapToGlobal(QPoint(0, 0)).y() == title_end

    qtbot.waitUntil(beside, timeout=10_000)


SCANS = (MANUAL, SIMULATED)


def test_save_stays_in_view_below_the_plot_of_a_step(dock, qtbot, open_recording):
    """Before: the panel named Save as the next action, and the window of a laptop displayed it only when scrolled."""
    dock.viewer.window.resize(*SIZES[0])
    dock.show_tab("Calibration")
    panel = dock.by_title["Calibration"].panel
    panel.choose("pair")
    panel.measure_file(open_recording / "transmission.tif")
    qtbot.waitUntil(lambda: panel.candidate is not None and not panel.work.busy, timeout=60_000)
    panel.accept()
    panel.choose("pair")
    qtbot.waitUntil(lambda: panel.form.plots[0].isVisible(), timeout=60_000)
    save = panel.form.save
    assert save.isEnabled()
    qtbot.waitUntil(lambda: save.visibleRegion().boundingRect() == save.rect(), timeout=10_000)
