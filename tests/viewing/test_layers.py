"""A recording becomes layers that know where, when and how large they are."""

from __future__ import annotations

import numpy as np
import pytest
import tifffile

from napari_elsplus.errors import CalibrationError
from napari_elsplus.io import ImageMetadata, open_recording, write_calibration, write_images, write_mosaic
from napari_elsplus.viewing.layers import open_layers
from napari_elsplus.viewing.outlines import calibration_layers, summary
from napari_elsplus.viewing.stack import Stack
from napari_elsplus.viewing.stack import attributes as layer_attributes
from napari_elsplus.workflows.sectioning import section
from pairs import FRAME_PERIOD_S, calibration, frames, write_pair


def by_name(opened):
    return {attributes["name"]: (data, attributes) for data, attributes, _ in opened.layers}


def test_a_recording_with_its_calibration_gives_five_layers(tmp_path):
    opened = open_layers(write_pair(tmp_path))
    layers = by_name(opened)
    assert list(layers) == ["scan raw", "scan LS", "scan residual", "scan ELSA", "scan ELS+"]
    assert opened.notes == []
    np.testing.assert_array_equal(layers["scan raw"][0], frames())
    for name, mode in (("scan LS", "ls"), ("scan residual", "residual"), ("scan ELS+", "els"), ("scan ELSA", "elsa")):
        np.testing.assert_array_equal(layers[name][0], section(frames(), calibration(), mode)[:])
    assert [name for name, (_, attributes) in layers.items() if attributes["visible"]] == ["scan ELS+"]
    assert [name for name, (_, attributes) in layers.items() if "interpolation2d" not in attributes] == ["scan raw"]


def test_layers_know_their_scale_and_lie_where_they_are_in_the_frame(tmp_path):
    layers = by_name(open_layers(write_pair(tmp_path)))
    for name, (data, attributes) in layers.items():
        assert attributes["units"] == ("s", "um", "um")
        assert attributes["scale"][1:] == (2.0, 2.0)
        assert attributes["scale"][0] == pytest.approx((2 if name.endswith("ELSA") else 1) * FRAME_PERIOD_S)
        if name != "scan raw":
            middle = np.array(attributes["translate"][1:]) + 2.0 * (data.shape[1] - 1) / 2
            np.testing.assert_allclose(middle, [64.0, 62.0])
    provenance = layers["scan ELS+"][1]["metadata"]["elsplus"]
    assert provenance["kind"] == "els"
    assert provenance["calibration_path"] == tmp_path / "scan.calibration.json"
    assert provenance["software"].startswith("napari-elsplus")


def test_images_of_a_view_that_the_frame_cuts_are_displayed_up_to_their_white(tmp_path):
    """Before: between 0 and 1, as pixels that were not seen are NaN."""
    write_calibration(tmp_path / "a.calibration.json", calibration().model_copy(update={"frame": None}))
    tifffile.imwrite(tmp_path / "a.tif", frames()[:, :, :110])
    layers = by_name(open_layers(tmp_path / "a.tif"))
    assert np.isnan(layers["a ELS+"][0][0]).any()
    whites = {name: attributes["contrast_limits"][1] for name, (_, attributes) in layers.items()}
    assert whites["a ELS+"] == pytest.approx(100, abs=10)
    assert 60 <= whites["a residual"] <= 80  # resampling overshoots at the cut


def test_one_frame_makes_no_elsa(tmp_path):
    assert list(by_name(open_layers(write_pair(tmp_path, 1)))) == ["scan raw", "scan LS", "scan residual", "scan ELS+"]


def test_layers_are_named_after_the_whole_name_of_their_file(tmp_path):
    """Before: after what precedes the first dot, by which recordings of one day had the same name."""
    tifffile.imwrite(tmp_path / "2026.01.05 skin.ome.tif", frames())
    with open_recording(tmp_path / "2026.01.05 skin.ome.tif") as recording:
        assert Stack.of(recording).name == "2026.01.05 skin"


def test_without_a_calibration_there_are_raw_frames_in_pixels(tmp_path):
    tifffile.imwrite(tmp_path / "a.tif", frames())
    opened = open_layers(tmp_path / "a.tif")
    ((_, attributes, kind),) = opened.layers
    assert (attributes["name"], kind, attributes["visible"]) == ("a raw", "image", True)
    assert attributes["units"] == ("pixel", "pixel", "pixel")
    assert opened.notes == []


def test_a_recordings_own_calibration_needs_no_note_where_it_is_the_active_one_too(tmp_path):
    """Before: it was warned of as if it were that of another recording."""
    path = write_pair(tmp_path)
    assert open_layers(path, tmp_path / "scan.calibration.json").notes == []


def test_the_active_calibration_is_for_recordings_without_their_own(tmp_path):
    tifffile.imwrite(tmp_path / "a.tif", frames())
    (tmp_path / "rig").mkdir()
    active = write_calibration(tmp_path / "rig" / "c.json", calibration())
    opened = open_layers(tmp_path / "a.tif", active)
    assert len(opened.layers) == 5
    assert "active calibration, c.json" in opened.notes[0]
    assert open_layers(write_pair(tmp_path), active).notes == []


@pytest.mark.parametrize("case", ["broken", "other region", "no bundle"])
def test_a_calibration_that_does_not_do_leaves_the_raw_layer_and_a_note(tmp_path, case):
    path = write_pair(tmp_path)
    beside = tmp_path / "scan.calibration.json"
    if case == "broken":
        beside.write_text('{"format": "napari-elsplus/calibration", "version": 99}')
    elif case == "other region":
        tifffile.imwrite(path, frames()[:, :60])
    else:
        write_calibration(beside, calibration().model_copy(update={"bundle": None}), force=True)
    opened = open_layers(path)
    assert list(by_name(opened)) == ["scan raw"]
    assert opened.layers[0][1]["visible"]
    assert len(opened.notes) == 1
    assert "displayed as raw frames only" in opened.notes[0]


def test_finished_images_are_not_taken_for_raw_frames(tmp_path):
    els = section(frames(), calibration(), "els")[:]
    write_images(tmp_path / "out.tif", els, ImageMetadata(calibration=calibration(), settings={"mode": "els"}))
    ((data, attributes, _),) = open_layers(tmp_path / "out.tif").layers
    np.testing.assert_array_equal(data, els)
    assert attributes["name"] == "out ELS+"
    assert attributes["scale"] == pytest.approx((FRAME_PERIOD_S, 2.0, 2.0))


def test_a_single_finished_image_has_two_axes(tmp_path):
    mosaic = np.random.default_rng(0).random((50, 70)).astype(np.float32)
    write_mosaic(tmp_path / "m.ome.tif", mosaic, ImageMetadata(um_per_px=2.5))
    ((data, attributes, _),) = open_layers(tmp_path / "m.ome.tif").layers
    np.testing.assert_array_equal(data, mosaic)
    assert attributes["scale"] == (2.5, 2.5)
    assert attributes["units"] == ("um", "um")


def test_a_calibration_shows_the_outlines_of_both_views(tmp_path):
    path = write_calibration(tmp_path / "c.json", calibration())
    opened = calibration_layers(path)
    ((outlines, attributes, kind),) = opened.layers
    assert kind == "shapes"
    assert attributes["scale"] == (2.0, 2.0)
    np.testing.assert_allclose([outline.mean(axis=0) for outline in outlines], [[32, 31], [30, 95]])
    np.testing.assert_allclose(np.ptp(outlines, axis=1), 48)
    assert "slit offset -4.00 ± 0.02 rows" in opened.notes[0]
    assert "alignment error 1.2 %" in opened.notes[0]


def test_a_calibration_without_a_bundle_says_what_it_holds(tmp_path):
    path = write_calibration(tmp_path / "c.json", calibration().model_copy(update={"bundle": None}))
    assert calibration_layers(path).layers == []
    assert summary(type(calibration())()) == "no measured section"
    exact = type(calibration()).parse({"offset": {"rows": -12.034, "uncertainty_rows": 0.002}})
    assert summary(exact) == "slit offset -12.034 ± 0.002 rows"


def test_a_broken_calibration_is_refused(tmp_path):
    (tmp_path / "c.json").write_text("[]")
    with pytest.raises(CalibrationError):
        calibration_layers(tmp_path / "c.json")


def test_opening_touches_no_more_than_the_first_frames(tmp_path, monkeypatch):
    asked = []
    original = tifffile.TiffPage.asarray

    def counted(page, *args, **kwargs):
        asked.append(page.index)
        return original(page, *args, **kwargs)

    monkeypatch.setattr(tifffile.TiffPage, "asarray", counted)
    monkeypatch.setattr(tifffile.TiffFrame, "asarray", counted)
    open_layers(write_pair(tmp_path, 40))
    assert len(asked) <= 2


def test_the_calibrations_frame_rate_replaces_the_playback_rate_of_a_video(tmp_path):
    with open_recording(write_pair(tmp_path)) as recording:
        recording.metadata |= {"frame_period_s": 0.04, "playback": True}
        assert layer_attributes(Stack.of(recording), "raw", calibration())["scale"][0] == pytest.approx(FRAME_PERIOD_S)
        assert layer_attributes(Stack.of(recording), "raw", None)["scale"][0] == 0.04
        assert recording.times_by(calibration())[1] == pytest.approx(FRAME_PERIOD_S)
