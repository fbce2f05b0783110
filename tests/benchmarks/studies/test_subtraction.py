"""Weights of the residual and series of offsets against one offset and a weight of one."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from benchmarks.documents import subtraction
from benchmarks.studies.offset_series import offset_weights
from benchmarks.studies.subtraction import Views, compare_weights
from napari_elsplus.processing.images.sectioning import disc
from napari_elsplus.simulation.model.axial_response import line_response
from napari_elsplus.simulation.model.instrument import Instrument

SIDE, LEAK = 240, 0.2


def seen(haze: float, ratio: float = 1.3, seed: int = 1) -> Views:
    """Fine structure in focus and coarse haze, which the confocal view shows `ratio` times as strongly."""
    random = np.random.default_rng(seed)
    fine, coarse = (
        cv2.GaussianBlur(random.normal(0, sigma, (SIDE, SIDE)).astype(np.float32), (0, 0), sigma) for sigma in (2, 8)
    )
    residual = LEAK * fine + haze * coarse
    return Views(fine + ratio * haze * coarse, residual, fine, disc(SIDE, 0.9 * SIDE))


def test_strong_haze_has_a_best_weight_of_its_own() -> None:
    (_, ls), (_, els), (weight, best) = compare_weights(seen(5.0))
    assert weight == pytest.approx(1.3, abs=0.03)
    assert best > els > ls


def test_combined_offsets_keep_what_is_in_focus_and_suppress_haze_more_than_one() -> None:
    instrument, offsets_um = Instrument.of("240hz"), (8.0, 12.0, 29.0)
    weights = offset_weights(offsets_um, instrument)

    def response(depth_um: float) -> float:
        of = [line_response(depth_um, place, instrument.slit_um, instrument.line) for place in (0.0, *offsets_um)]
        return float(weights @ of)

    def alone(depth_um: float) -> float:
        ls, residual = (line_response(depth_um, place, instrument.slit_um, instrument.line) for place in (0.0, 8.0))
        return float(ls - residual)

    for depth_um in (20.0, 40.0):
        assert abs(response(depth_um) / response(0.0)) < alone(depth_um) / alone(0.0)


def test_charts_and_tables_are_put_into_the_page(tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(subtraction, "views", lambda _, scene, seed: seen(scene.planes[-2].brightness, seed=seed))
    monkeypatch.setattr(subtraction, "rig", lambda *_: None)
    alone = [0.9, 0.95, 0.93, 0.92, 0.9, 0.8]
    monkeypatch.setattr(subtraction, "compare_offsets", lambda *_: (alone, 0.96, 0.97))
    (tmp_path / "images").mkdir()
    page = tmp_path / "physics.md"
    page.write_text("<!-- weights -->\n<!-- end -->\n<!-- offset-series -->\n<!-- end -->\n")
    subtraction.make(tmp_path, quick=True)
    text = page.read_text()
    assert "| a, 1, 20 um | 0.950 (8) | 0.900 | 0.960 | +0.010 | 0.970 |" in text
    assert "over 8 images" in text
    assert {file.name for file in (tmp_path / "images").iterdir()} == {
        "physics-weights.png",
        "physics-offset-series.png",
    }
