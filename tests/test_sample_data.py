"""The samples: simulated as they are looked at, to scale, with the calibration that fits them."""

from __future__ import annotations

import numpy as np
import pytest

from napari_elsplus import _sample_data
from napari_elsplus.instrument.optics import PRESETS
from napari_elsplus.processing.calibration.calibrate import measure
from napari_elsplus.simulation.model.instrument import Instrument


def by_name(layers):
    return {attributes["name"]: (data, attributes) for data, attributes, _ in layers}


@pytest.fixture(scope="module")
def recording():
    return by_name(_sample_data.recording())


def test_els_is_ls_minus_residual_and_keeps_the_fibres(recording):
    ls, residual, els = (np.asarray(recording[f"fibres {name}"][0][3]) for name in ("LS", "residual", "ELS+"))
    np.testing.assert_array_equal(els, ls - residual)
    assert np.median(els[ls > 5]) < 0.8 * np.median(ls[ls > 5])
    assert np.percentile(els, 99.9) > 0.6 * np.percentile(ls, 99.9)


def test_three_images_stand_side_by_side_in_micrometres(recording):
    titles, above = recording["fibres titles"]
    shown = [(data, attributes) for data, attributes in recording.values() if attributes["visible"]][1:]
    um_per_px = PRESETS["240hz"].optics.um_per_px
    lefts = [attributes["translate"][2] for _, attributes in shown]
    assert [attributes["name"] for _, attributes in shown] == ["fibres LS", "fibres residual", "fibres ELS+"]
    assert all(attributes["scale"][1:] == (um_per_px, um_per_px) for _, attributes in shown)
    assert np.all(np.diff(lefts) > shown[0][0].shape[2] * um_per_px)
    assert above["features"] == {"title": ["LS", "residual", "ELS+"]}
    np.testing.assert_allclose(titles[:, 1] * above["scale"][1], lefts)
    assert np.all(titles[:, 0] * above["scale"][0] < shown[0][1]["translate"][1])


def test_the_calibration_set_gives_the_calibration_of_the_instrument_it_was_made_with():
    layers = by_name(_sample_data.calibration_set())
    sweep, attributes = layers["calibration sweep"]
    every = slice(None, None, 8)
    found = measure(
        line=np.asarray(layers["calibration line"][0]),
        sweep=np.asarray(sweep[every]),
        volts=attributes["metadata"]["elsplus"]["volts"][every],
        bundle=np.asarray(layers["calibration distal light"][0]),
        background=np.asarray(layers["calibration dark tube"][0][:10]),
    ).calibration
    instrument = Instrument.of("240hz")
    assert found.offset.rows == pytest.approx(instrument.offset_rows, abs=0.05)
    assert found.galvo.volts_per_row == pytest.approx(instrument.volts_per_row, rel=2e-3)
    assert found.bundle.confocal_centre == pytest.approx(instrument.confocal_centre, abs=0.2)


def test_the_axial_scan_knows_its_depths_and_falls_faster_in_els():
    layers = by_name(_sample_data.axial_scan())
    assert list(layers) == ["plate raw", "plate LS", "plate residual", "plate ELS+"]
    depth_um = layers["plate ELS+"][1]["metadata"]["elsplus"]["stack"].depth_um
    far = int(np.searchsorted(depth_um, 118))
    falls = {
        name: float(np.asarray(data[far]).sum() / np.asarray(data[0]).sum())
        for name, (data, _) in layers.items()
        if name in ("plate LS", "plate ELS+")
    }
    assert falls["plate LS"] > 0.25
    assert falls["plate ELS+"] == pytest.approx(0.1, abs=0.03)  # the paper's 10 dB lie at 119 um for this offset
