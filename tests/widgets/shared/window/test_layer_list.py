"""The viewer's list of layers while images stream."""

from __future__ import annotations

import numpy as np
from qtpy.QtWidgets import QListView, QWidget

from napari_elsplus.widgets.shared.window.layer_list import LayerListModels


def test_the_list_hears_nothing_of_new_pixels_and_of_everything_afterwards(make_napari_viewer_proxy):
    viewer = make_napari_viewer_proxy()
    layer = viewer.add_image(np.zeros((20, 20)))
    panel = QWidget()
    viewer.window.add_dock_widget(panel)
    layers = LayerListModels(panel)
    heard = []
    for view in panel.window().findChildren(QListView):
        view.model().dataChanged.connect(lambda *_: heard.append(layer.name))
    with layers.signals_blocked():
        layer.events.set_data()
        layer.refresh(thumbnail=False, extent=False, highlight=False)
    assert heard == []
    with layers.signals_blocked(), layers.signals_blocked():
        pass
    layer.name = "another"
    assert heard
