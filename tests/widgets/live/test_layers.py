"""Layers of live images, without an engine."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from napari_elsplus._writer import write_image
from napari_elsplus.io import open_recording
from napari_elsplus.widgets.live.layers import LiveLayers
from pairs import calibration, write_pair


@pytest.mark.parametrize(("dtype", "white"), [("u1", 255), ("u2", 65535)])
def test_raw_frames_are_displayed_over_all_grey_levels_of_the_camera(viewer, dtype, white):
    ring = SimpleNamespace(layout=SimpleNamespace(fields=[("raw", (40, 80), dtype)]))
    layers = LiveLayers(viewer)
    layers.arrange(["raw"], ring, None, side_by_side=False)
    layers.rescale_contrast("raw")
    assert tuple(layers.images["raw"].contrast_limits) == (0, white)


def test_the_scale_of_other_layers_is_not_saved_as_that_of_live_images(viewer, tmp_path):
    """Live images are in micrometres beside a calibrated recording, and measured from their own calibration on."""
    viewer.open(str(write_pair(tmp_path)), plugin="napari-elsplus")
    ring = SimpleNamespace(layout=SimpleNamespace(fields=[("els", (40, 40), "f4")]))
    layers, found = LiveLayers(viewer), []
    for known in (None, calibration(), None):
        layers.arrange(["els"], ring, known, side_by_side=False)
        assert [str(unit) for unit in layers.images["els"].units] == ["micrometer", "micrometer"]
        data, attributes, _ = layers.images["els"].as_layer_data_tuple()
        write_image(str(tmp_path / "live.tif"), data, attributes)
        with open_recording(tmp_path / "live.tif") as back:
            found.append(back.metadata.get("um_per_px"))
    assert found == [None, 2.0, None]
