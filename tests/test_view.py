from __future__ import annotations

import numpy as np
import pytest
from napari.components import ViewerModel

from napari_elsplus._view import FILLED, fit_visible_layers


def test_visible_layers_fill_the_canvas_and_hidden_or_empty_ones_do_not_count():
    viewer = ViewerModel()
    viewer.add_image(np.zeros((4, 1000, 3000)), visible=False)
    viewer.add_points(np.empty((0, 2)))
    viewer.add_image(np.zeros((101, 201)), scale=(2, 2), translate=(100, 40))
    fit_visible_layers(viewer)
    assert viewer.scene.camera.center[-2:] == pytest.approx((200, 240))
    assert viewer.scene.camera.zoom == pytest.approx(FILLED * min(np.array(viewer.canvas.size) / (200, 400)))


@pytest.mark.parametrize("visible", [True, False])
def test_a_view_without_anything_to_fit_stays(visible):
    viewer = ViewerModel()
    viewer.add_points(np.empty((0, 2)), visible=visible)
    before = viewer.scene.camera.center, viewer.scene.camera.zoom
    fit_visible_layers(viewer)
    assert (viewer.scene.camera.center, viewer.scene.camera.zoom) == before
