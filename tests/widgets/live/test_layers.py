"""Layers of live images, without an engine."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from napari.layers._layer_actions import _duplicate_layer as duplicate_layers

from napari_elsplus._writer import write_image
from napari_elsplus.acquisition.engine.live_images import display_layout
from napari_elsplus.acquisition.streaming.ring import Ring
from napari_elsplus.hardware.protocols import FrameInfo
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


@pytest.fixture
def stream(viewer):
    """Live layers, and a function that displays a frame of noise and so many grey levels of light."""
    layout = display_layout((64, 128), 32)
    ring, layers = Ring(bytearray(layout.nbytes), layout), LiveLayers(viewer)
    while not layers.arrange(["ls", "raw"], ring, None, side_by_side=True):
        pass
    noise = np.random.default_rng(1).normal(0, 0.5, (32, 32))

    def show(light, *, whole=True):
        slot = ring.acquire()
        slot.arrays["ls"][...] = noise
        slot.arrays["ls"][8:24, 8:24] += light
        ring.finalize(slot, FrameInfo(0, 0.0, 0.0))
        layers.update(ring, whole=whole)
        return tuple(layers.images["ls"].contrast_limits)

    return layers, show


def test_the_layers_of_a_closed_panel_are_used_again_and_copies_are_the_users(stream, viewer):
    """Before: the next panel added a second set of layers."""
    layers, _ = stream
    layers.images["ls"].colormap, layers.images["ls"].contrast_limits = "magenta", (3, 77)
    duplicate_layers(viewer.layers)
    before = {layer.name for layer in viewer.layers}
    layout = display_layout((64, 128), 32)
    again, ring = LiveLayers(viewer), Ring(bytearray(layout.nbytes), layout)
    while not again.arrange(["ls", "raw"], ring, None, side_by_side=True):
        pass
    assert {layer.name for layer in viewer.layers} == before
    assert again.images == layers.images
    shown = again.images["ls"]
    assert (shown.colormap.name, tuple(shown.contrast_limits)) == ("magenta", (3, 77))


def test_what_does_not_change_is_not_set_again(stream, viewer):
    """Setting an equal value costs the window some milliseconds, for each layer and each change of a control."""
    layers, show = stream
    show(100)
    layout = display_layout((64, 128), 32)
    ring, changes = Ring(bytearray(layout.nbytes), layout), []
    for layer in viewer.layers:
        for name in ("scale", "translate", "units", "visible", "data", "features"):
            if hasattr(layer.events, name):
                getattr(layer.events, name).connect(lambda event: changes.append((event.source.name, event.type)))
    assert layers.arrange(["ls", "raw"], ring, None, side_by_side=True)
    assert changes == []
    assert layers.arrange(["ls"], ring, None, side_by_side=True)
    assert ("live raw", "visible") in changes
    assert "live LS" not in {name for name, _ in changes}


def test_contrast_of_once_is_that_of_the_first_frame_with_light(stream):
    """Before: a stream that began in the dark, laser off or galvo parked, was white ever after."""
    layers, show = stream
    assert show(0)[1] < 5
    assert show(100, whole=False)[1] < 5, "a full refresh is due once a second"
    lit = show(100)
    assert lit == (0, pytest.approx(101, abs=3))
    assert show(200) == show(0) == lit
    assert tuple(layers.images["raw"].contrast_limits) == (0, 255)


def test_contrast_that_the_user_sets_in_the_dark_stays(stream):
    layers, show = stream
    show(0)
    layers.images["ls"].contrast_limits = (0, 40)
    assert show(100) == (0, 40)
    show(0)
    layers.rescale_contrast("ls")
    layers.keep_contrast()
    assert show(100)[1] < 5
