"""Keys of the panels: pressed from any tab, each does one thing, and none is napari's."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from napari.settings import get_settings
from qtpy.QtCore import Qt
from qtpy.QtGui import QKeySequence, QShortcut
from qtpy.QtTest import QTest
from qtpy.QtWidgets import QAbstractButton, QApplication, QPushButton

from napari_elsplus.widgets.shared.plots import ThemedPlot
from napari_elsplus.widgets.shared.window.keys import KEYS, key_name

PLUGIN = "napari-elsplus"


@pytest.fixture
def dock(small_engine, make_napari_viewer_proxy, qtbot):
    """The dock in an active window, with the Quality tab in front, which has no keys."""
    viewer = make_napari_viewer_proxy(show=True)
    _, dock = viewer.window.add_plugin_dock_widget(PLUGIN, "ELS+")
    qtbot.waitUntil(lambda: all(tab.built for tab in dock.by_title.values()), timeout=30_000)
    dock.show_tab("Quality")
    window = dock.window()
    window.activateWindow()
    qtbot.waitUntil(window.isActiveWindow, timeout=60_000)
    qtbot.waitUntil(lambda: len(bound(window)) == len(KEYS), timeout=60_000)
    return dock


def bound(window):
    """The plugin's shortcuts that act in the whole window, by key."""
    keys = {QKeySequence(key).toString() for key in KEYS.values()}
    own = [one for one in window.findChildren(QShortcut) if one.parent() is window]
    return {one.key().toString(): one for one in own if one.key().toString() in keys}


def entries(menu):
    """Every entry of a menu and of its submenus."""
    for action in menu.actions():
        yield from entries(action.menu()) if action.menu() is not None else [action]


def press(window, key):
    code = QKeySequence(key)[0]
    QTest.keyClick(window, code.key(), code.keyboardModifiers())
    QApplication.processEvents()


def test_each_key_pressed_acts_once_from_another_tab_and_is_not_ambiguous(dock):
    window, pressed = dock.window(), []
    for key, shortcut in bound(window).items():
        shortcut.activated.disconnect()
        shortcut.activated.connect(lambda key=key: pressed.append(key))
        shortcut.activatedAmbiguously.connect(lambda key=key: pressed.append(f"{key} is ambiguous"))
    for key in KEYS.values():
        press(window, key)
    assert pressed == [QKeySequence(key).toString() for key in KEYS.values()]


@pytest.mark.checkout
@pytest.mark.parametrize("title", ["Rig", "Calibration", "Compare", "Quality"])
def test_the_tab_key_goes_from_the_tabs_through_all_of_a_panel(dock, title):
    """Before: the title's buttons, and napari's docks for some panels, lay between them."""
    dock.show_tab(title)
    QApplication.processEvents()
    bar = dock.tabs.tabBar()
    bar.setFocus()
    panel, reached = dock.by_title[title].panel, []
    while (one := QApplication.focusWidget()) is bar or panel.isAncestorOf(one):
        reached.append(one)
        QTest.keyClick(one, Qt.Key.Key_Tab)
    buttons = [one for one in panel.findChildren(QPushButton) if one.isVisible() and one.isEnabled()]
    assert set(reached) >= set(buttons)
    assert not any(isinstance(one, ThemedPlot) for one in reached), "nothing can be done in it by keys"


def test_every_key_is_listed_in_the_documentation():
    """Before: four of ten."""
    page = (Path(__file__).parents[3] / "docs" / "live.md").read_text(encoding="utf-8")
    assert sorted(re.findall(r"^\| (Ctrl\S+) \|", page, re.MULTILINE)) == sorted(KEYS.values())


def test_no_key_is_one_of_napari(dock):
    ours = {QKeySequence(key) for key in KEYS.values()}
    assert len(ours) == len(KEYS)
    menus = {key for action in entries(dock.window().menuBar()) for key in action.shortcuts()}
    settings = get_settings().shortcuts.shortcuts
    bindings = {QKeySequence(str(key).replace(" ", "+")) for keys in settings.values() for key in keys}
    assert QKeySequence("Ctrl+Shift+P") in menus
    assert QKeySequence("Ctrl+Shift+T") in menus | bindings
    assert ours & (menus | bindings) == set()


def test_a_panel_in_a_dock_of_its_own_keeps_one_key_each(dock):
    before = len(bound(dock.window()))
    dock.viewer.window.add_plugin_dock_widget(PLUGIN, "Live")
    QApplication.processEvents()
    live = [one for one in dock.window().findChildren(QShortcut) if one.key() == QKeySequence(KEYS["live"])]
    assert len(live) == 1
    assert len(bound(dock.window())) == before


def test_the_next_step_of_the_calibration_comes_by_its_key(dock):
    calibration = dock.by_title["Calibration"].panel
    assert calibration.key == "offset"
    press(dock.window(), KEYS["next step"])
    assert calibration.key == "galvo"


def test_tooltips_name_the_keys(dock):
    tooltips = " ".join(button.toolTip() for button in dock.findChildren(QAbstractButton))
    assert [action for action in KEYS if f"({key_name(action)})" not in tooltips] == []
