"""Predicted sectioning agrees with simulated scans of depths, for a line that was calibrated on simulated frames."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from benchmarks.documents.recommendation import SEED, SETTINGS
from benchmarks.rigs.clipped_response import clipped_drop_offs
from benchmarks.studies.recommendation import Setting, calibrated, compare_prediction, random_settings
from napari_elsplus.cli import main
from napari_elsplus.errors import CalibrationError, InputError
from napari_elsplus.instrument.calibration import Calibration
from napari_elsplus.io import write_calibration
from napari_elsplus.simulation.model.axial_response import LINE_MODELS, model_response
from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.simulation.truth import true_calibration
from napari_elsplus.workflows.recommendation.line_estimate import calibrated_line
from napari_elsplus.workflows.recommendation.recommend import predict_line, recommend

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture
def few_draws(monkeypatch: pytest.MonkeyPatch) -> None:
    """For what is said of the expected values alone: uncertainties are of 4 lines instead of 64."""
    monkeypatch.setattr("napari_elsplus.workflows.recommendation.recommend.DRAWS", 4)


@pytest.mark.parametrize("state", ["a", "b"])
def test_core_and_halo_of_the_standing_line_are_those_of_the_simulated_one(state: str) -> None:
    estimate, true = calibrated_line(calibrated(state)), LINE_MODELS[state]
    assert estimate.line.core_um == pytest.approx(true.core_um, rel=0.03)
    assert estimate.line.halo_um == pytest.approx(true.halo_um, rel=0.05)
    assert estimate.line.halo_share == pytest.approx(true.halo_share, abs=0.01)


@pytest.mark.parametrize(("state", "offset_um", "slit_rows"), random_settings(20, 900))
def test_predicted_drop_offs_agree_with_the_instrument(state: str, offset_um: float, slit_rows: float) -> None:
    instrument = replace(
        Instrument.of("120hz", offset_um=offset_um, line=LINE_MODELS[state]), slit_rows=slit_rows
    )  # fmt: skip
    true = clipped_drop_offs(instrument)[1]
    line = calibrated_line(calibrated(state)).line
    found = predict_line(line, offset_um, instrument.slit_um, 100.0)
    assert (found.drop_3db_um, found.drop_10db_um) == pytest.approx(tuple(true), rel=0.05)


@pytest.mark.parametrize(
    "setting",
    [setting if k == 0 else pytest.param(setting, marks=pytest.mark.slow)
     for k, setting in enumerate(random_settings(SETTINGS, SEED))],
)  # fmt: skip
def test_measured_drop_offs_lie_within_the_stated_uncertainty(setting: Setting) -> None:
    compared = compare_prediction(setting)
    for name in ("drop_3db_um", "drop_10db_um"):
        assert abs(compared[name].error) < 0.05
    assert max(one.sigmas for one in compared.values()) < 2


def test_a_measured_plate_replaces_the_modelled_spread_and_gap() -> None:
    true = replace(LINE_MODELS["a"], spread=0.3, gap_um=8.0)
    depths = np.arange(0, 250, 5.0)
    plate = {
        "depth_um": depths.tolist(),
        "profiles": {"ls": model_response(depths, offset_um=29.0, line=true).ls.tolist()},
    }
    estimate = calibrated_line(calibrated("a"), plate)
    assert (estimate.line.spread, estimate.line.gap_um) == pytest.approx((0.3, 8.0), rel=0.1)
    assert not estimate.assumed
    assert estimate.measured_to_um == 245.0
    with pytest.raises(InputError, match="no depths"):
        calibrated_line(calibrated("a"), {"profiles": {"ls": [1.0, 0.5]}})


def test_the_recommended_setting_keeps_enough_and_suppresses_haze_best(few_draws: None) -> None:
    found = recommend(calibrated("b"), 100.0, 0.95)
    assert found.expected.signal_kept == pytest.approx(0.95, abs=1e-3)
    assert found.expected.haze < found.present.haze
    assert found.offset_rows < 0  # the sign of the calibrated one
    less = recommend(calibrated("b"), 100.0, 0.9)
    assert less.expected.haze < found.expected.haze
    assert abs(less.offset_rows) < abs(found.offset_rows)


def test_what_lies_beyond_the_measured_depths_and_compared_offsets_is_noted(few_draws: None) -> None:
    depths = np.arange(0, 150, 5.0)
    profile = model_response(depths, offset_um=29.0, line=LINE_MODELS["a"]).ls.tolist()
    plate = {"depth_um": depths.tolist(), "profiles": {"ls": profile}}
    assert recommend(calibrated("a"), 100.0, 0.8, plate).notes == ()
    (beyond,) = recommend(calibrated("a"), 400.0, 0.8, plate).notes
    assert "haze at 400 um: extrapolated beyond the 145 um to which the plate was measured" in beyond
    assumed, beyond = recommend(calibrated("a"), 400.0, 0.8).notes
    assert "of the model" in assumed
    assert "haze at 400 um: extrapolated beyond the 300 um" in beyond
    far, wide = recommend(calibrated("a"), 100.0, 0.99, plate).notes
    assert "10 dB at " in far
    assert "beyond the 12 to 80 um at which predictions were compared" in wide


def test_what_cannot_be_recommended_is_refused_in_one_line() -> None:
    with pytest.raises(InputError, match=r"no offset up to 15\d um keeps 99\.9999 %"):
        recommend(calibrated("a"), 100.0, 0.999999)
    with pytest.raises(InputError, match="the depth is -3 um"):
        recommend(calibrated("a"), -3.0)
    old = true_calibration(Instrument.of("120hz")).content()
    old["offset"] = {key: old["offset"][key] for key in ("rows", "uncertainty_rows", "tilt_deg")}
    with pytest.raises(CalibrationError, match="no core and halo of the line"):
        recommend(Calibration.parse(old), 100.0)


def test_the_command_prints_and_writes_each_value_with_its_uncertainty(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_calibration(tmp_path / "cal.json", calibrated("b"))
    main(["recommend", "--depth-um", "100", "-c", str(tmp_path / "cal.json"), "-o", str(tmp_path / "out.json")])
    assert "slit " in capsys.readouterr().out
    content = json.loads((tmp_path / "out.json").read_text("utf-8"))
    for name in ("slit_rows", "offset_rows", "signal_kept", "drop_3db_um", "drop_10db_um"):
        assert np.isfinite(content[name])
        assert content[f"{name}_sigma"] >= 0


@pytest.mark.parametrize(
    ("depths", "ls", "problem"),
    [
        ([*range(6)], [0.0] * 6, "no LS curve"),
        ([*range(6)], [1e300] * 6, "no LS curve"),
        (5.0, 3.0, "no depths or no LS profile"),
        ([*range(6)], [1.0] * 5, "no depths or no LS profile"),
        ([*range(6)], [1.0, *[float("nan")] * 5], "measured at 1 depths"),
    ],
)
def test_a_plate_that_no_line_can_be_fitted_to_is_refused(depths: Any, ls: Any, problem: str) -> None:
    """Before: the errors of numpy and scipy, with a traceback on the command line."""
    with pytest.raises(InputError, match=problem):
        calibrated_line(calibrated("a"), {"depth_um": depths, "profiles": {"ls": ls}})
