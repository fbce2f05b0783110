"""The sample recording: three images of one sweep, to scale, side by side."""

from __future__ import annotations

import numpy as np
import pytest

from napari_elsplus import _sample_data
from napari_elsplus.calibration import Calibration
from napari_elsplus.optics import PRESETS


@pytest.fixture(scope="module")
def layers() -> list[_sample_data.LayerData]:
    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.setattr(_sample_data, "FRAMES", 3)
        return _sample_data.recording()


def test_els_is_ls_minus_residual(layers: list[_sample_data.LayerData]) -> None:
    (ls, _, _), (residual, _, _), (els, _, _) = layers
    assert ls.shape[0] == 3
    assert np.array_equal(els, ls - residual)


def test_subtraction_takes_light_away_but_not_the_fibres(layers: list[_sample_data.LayerData]) -> None:
    (ls, _, _), _, (els, _, _) = layers
    assert np.median(els[ls > 5]) < 0.8 * np.median(ls[ls > 5])
    assert np.percentile(els, 99.9) > 0.6 * np.percentile(ls, 99.9)


def test_layers_stand_side_by_side_in_micrometres(layers: list[_sample_data.LayerData]) -> None:
    um_per_px = PRESETS["240hz"].optics.um_per_px
    lefts = [settings["translate"][2] for _, settings, _ in layers]
    for _, settings, _ in layers:
        assert settings["scale"] == (1, um_per_px, um_per_px)
    assert np.all(np.diff(lefts) > layers[0][0].shape[2] * um_per_px)


def test_the_calibration_comes_with_the_layer(layers: list[_sample_data.LayerData]) -> None:
    _, settings, _ = layers[0]
    calibration = Calibration.parse(settings["metadata"]["calibration"])
    calibration.require("offset", "bundle", "optics")
