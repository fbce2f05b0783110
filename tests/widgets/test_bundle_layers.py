"""Layers of the bundle pair, without the panel."""

from __future__ import annotations

import pytest

from napari_elsplus._writer import write_image
from napari_elsplus.io import open_recording
from napari_elsplus.processing.calibration.draft import Draft, setup_of
from napari_elsplus.processing.calibration.measurements import measure_pair
from napari_elsplus.simulation.calibration_scenes import transmission
from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.widgets.calibration.bundle_layers import IMAGE, OUTLINES, BundleLayers
from napari_elsplus.widgets.calibration.session import ShownResult
from pairs import write_pair


def test_the_scale_of_other_layers_is_not_saved_as_that_of_the_bundle(viewer, tmp_path):
    """Its image is in micrometres beside a calibrated recording, and measured once its own scale is known."""
    viewer.open(str(write_pair(tmp_path)), plugin="napari-elsplus")
    lit = list(transmission(Instrument.of("240hz")))[:2]
    pair, found, layers = measure_pair(lit), [], BundleLayers(viewer)
    for um_per_px in (None, 1.5, None):
        draft = Draft().with_bundle_um(None if um_per_px is None else um_per_px * pair.confocal.diameter_px)
        layers.show(ShownResult(pair, setup_of(lit), None, None), draft)
        assert [str(unit) for unit in viewer.layers[IMAGE].units] == ["micrometer", "micrometer"]
        data, attributes, _ = viewer.layers[IMAGE].as_layer_data_tuple()
        write_image(str(tmp_path / "bundle.tif"), data, attributes)
        with open_recording(tmp_path / "bundle.tif") as back:
            found.append(back.metadata.get("um_per_px"))
    assert found == [None, pytest.approx(1.5), None]


def test_a_layer_that_the_user_removes_stays_away_and_what_was_hidden_is_shown_again(viewer):
    """Before: it was added again, and the user's layers remained hidden for ever."""
    mine = viewer.add_points([[1.0, 1.0]], name="mine")
    viewer.add_points([[1.0, 1.0]], name="hidden", visible=False)
    viewer.layers.selection = {mine}
    camera = viewer.scene.camera
    camera.center, camera.zoom = (0.0, 1.0, 1.0), 40.0
    view = camera.center, camera.zoom
    lit = list(transmission(Instrument.of("240hz")))[:2]
    shown, layers = ShownResult(measure_pair(lit), setup_of(lit), None, None), BundleLayers(viewer)
    layers.show(shown, Draft())
    assert not mine.visible
    middle = viewer.layers[IMAGE].extent.world.mean(axis=0)
    assert camera.center[-2:] == pytest.approx(middle, abs=20.0), "before: most of it lay beside the canvas"
    viewer.layers.remove(IMAGE)
    layers.show(shown, Draft())
    assert [layer.name for layer in viewer.layers] == ["mine", "hidden", OUTLINES]
    layers.show(None, Draft())
    assert [(layer.name, layer.visible) for layer in viewer.layers] == [("mine", True), ("hidden", False)]
    assert viewer.layers.selection.active == mine
    assert (camera.center, camera.zoom) == view
