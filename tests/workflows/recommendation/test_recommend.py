"""Predicted sectioning agrees with simulated scans of depths, for a line that was calibrated on simulated frames."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
import pytest

from napari_elsplus.cli import main
from napari_elsplus.errors import CalibrationError, InputError
from napari_elsplus.instrument.calibration import Calibration
from napari_elsplus.io import write_calibration
from napari_elsplus.simulation.calibration_scenes import line_volts, standing_line
from napari_elsplus.simulation.model.axial_response import LINE_MODELS, axial_response
from napari_elsplus.simulation.model.clipped_response import clipped_drop_offs
from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.simulation.truth import true_calibration
from napari_elsplus.workflows.axial import measure_axial_response
from napari_elsplus.workflows.calibration import calibrate
from napari_elsplus.workflows.recommendation.line_estimate import calibrated_line
from napari_elsplus.workflows.recommendation.recommend import predict_line, prediction_sigmas, recommend
from napari_elsplus.workflows.simulated import simulate_axial_scan

if TYPE_CHECKING:
    from pathlib import Path


@cache
def calibrated(state: str, seed: int = 5) -> Calibration:
    """Calibration of a rig whose line was measured on frames of it standing still."""
    instrument = replace(Instrument.of("120hz"), line=LINE_MODELS[state])
    found = calibrate(line=list(standing_line(instrument, line_volts(instrument), seed=seed)))
    return true_calibration(instrument).model_copy(update={"offset": found.calibration.offset})


@pytest.mark.parametrize("state", ["a", "b"])
def test_core_and_halo_of_the_standing_line_are_those_of_the_simulated_one(state: str) -> None:
    estimate, true = calibrated_line(calibrated(state)), LINE_MODELS[state]
    assert estimate.line.core_um == pytest.approx(true.core_um, rel=0.03)
    assert estimate.line.halo_um == pytest.approx(true.halo_um, rel=0.05)
    assert estimate.line.halo_share == pytest.approx(true.halo_share, abs=0.01)


def settings(count: int, seed: int) -> list[tuple[str, float, float]]:
    random = np.random.default_rng(seed)
    return [
        (str(random.choice(["a", "b"])), float(random.uniform(12, 80)), float(random.integers(1, 7)))
        for _ in range(count)
    ]


@pytest.mark.parametrize(("state", "offset_um", "slit_rows"), settings(20, 900))
def test_predicted_drop_offs_agree_with_the_instrument(state: str, offset_um: float, slit_rows: float) -> None:
    instrument = replace(
        Instrument.of("120hz", offset_um=offset_um, line=LINE_MODELS[state]), slit_rows=slit_rows
    )  # fmt: skip
    true = clipped_drop_offs(instrument)[1]
    line = calibrated_line(calibrated(state)).line
    found = predict_line(line, offset_um, instrument.slit_um, 100.0)
    assert (found.drop_3db_um, found.drop_10db_um) == pytest.approx(tuple(true), rel=0.05)


@pytest.mark.parametrize(
    ("state", "offset_um", "slit_rows"),
    [case if k == 0 else pytest.param(*case, marks=pytest.mark.slow) for k, case in enumerate(settings(20, 901))],
)
def test_measured_drop_offs_lie_within_the_stated_uncertainty(state: str, offset_um: float, slit_rows: float) -> None:
    um = Instrument.of("120hz").optics.um_per_px
    estimate = calibrated_line(calibrated(state))
    found = predict_line(estimate.line, offset_um, slit_rows * um, 100.0)
    near = np.linspace(0.75, 1.3, 5)
    depths = np.unique(np.r_[0.0, 3.0, 6.0, found.drop_3db_um * near, found.drop_10db_um * near].round(1))
    scan = simulate_axial_scan(slit_um=slit_rows * um, offset_um=offset_um, state=state, depth_um=depths, seed=6)
    seen = measure_axial_response(scan, scan.calibration, depths)
    sigmas = prediction_sigmas(list(estimate.draws(32)), found, offset_um, slit_rows * um, 100.0)
    for drop, name in ((seen.els_3db, "drop_3db_um"), (seen.els_10db, "drop_10db_um")):
        predicted = getattr(found, name)
        assert predicted == pytest.approx(drop.um, rel=0.05)
        assert abs(predicted - drop.um) < 2 * np.hypot(sigmas[name], drop.uncertainty_um)
    kept = abs(found.signal_kept - seen.signal_kept)
    assert kept < 2 * np.hypot(sigmas["signal_kept"], seen.signal_kept_uncertainty)


def test_a_measured_plate_replaces_the_modelled_spread_and_gap() -> None:
    true = replace(LINE_MODELS["a"], spread=0.3, gap_um=8.0)
    depths = np.arange(0, 250, 5.0)
    plate = {
        "depth_um": depths.tolist(),
        "profiles": {"ls": axial_response(depths, offset_um=29.0, line=true).ls.tolist()},
    }
    estimate = calibrated_line(calibrated("a"), plate)
    assert (estimate.line.spread, estimate.line.gap_um) == pytest.approx((0.3, 8.0), rel=0.1)
    assert not estimate.assumed
    with pytest.raises(InputError, match="no depths"):
        calibrated_line(calibrated("a"), {"profiles": {"ls": [1.0, 0.5]}})


def test_the_recommended_setting_keeps_enough_and_suppresses_haze_best() -> None:
    found = recommend(calibrated("b"), 100.0, 0.95)
    assert found.expected.signal_kept == pytest.approx(0.95, abs=1e-3)
    assert found.expected.haze < found.present.haze
    assert found.offset_rows < 0  # the sign of the calibrated one
    less = recommend(calibrated("b"), 100.0, 0.9)
    assert less.expected.haze < found.expected.haze
    assert abs(less.offset_rows) < abs(found.offset_rows)


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
