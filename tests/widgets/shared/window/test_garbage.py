"""What napari searches for garbage after a layer was removed."""

from __future__ import annotations

import gc
import weakref

import numpy as np
import pytest

from napari_elsplus.widgets.shared import panel

PLUGIN = "napari-elsplus"


@pytest.fixture(autouse=True)
def no_panel_before(monkeypatch: pytest.MonkeyPatch) -> None:
    """Forget panels that other tests have left."""
    monkeypatch.setattr(panel, "_present", weakref.WeakSet())


class Noted(np.ndarray):
    """An array to which there may be weak references."""


def test_napari_searches_little_after_a_layer_was_removed_while_a_panel_is_open(viewer):
    """Before: the window stood still for a third of a second and more at each, seconds on a busy computer."""
    gc.unfreeze()  # what the fixtures have left out
    before, searched = len(gc.get_objects()), []
    dock, _ = viewer.window.add_plugin_dock_widget(PLUGIN, "Quality")
    viewer.layers.events.removed.connect(lambda _: searched.append(len(gc.get_objects())))
    viewer.layers.remove(viewer.add_image(np.zeros((4, 4))))
    assert searched[0] < before / 2
    viewer.window.remove_dock_widget(dock)
    assert gc.get_freeze_count() == 0


def test_the_memory_of_a_layer_that_was_there_before_the_panel_is_released(viewer):
    data = np.zeros((4, 4)).view(Noted)
    held, layer = weakref.ref(data), viewer.add_image(data)
    viewer.window.add_plugin_dock_widget(PLUGIN, "Quality")
    viewer.layers.remove(layer)
    del data, layer
    viewer.layers.remove(viewer.add_image(np.zeros((4, 4))))
    assert held() is None


def test_layers_of_a_sample_are_left_out(viewer):
    """It is opened while the panels are built."""
    viewer.open_sample(PLUGIN, "recording")
    viewer.window.add_plugin_dock_widget(PLUGIN, "Quality")
    for name in ("fibres ELS+", "fibres titles"):
        viewer.layers.remove(name)
        assert gc.get_freeze_count() > 0
