"""Imperfect rigs against their truth: what the benchmark judges by, and its quick form."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from benchmarks.imperfect import measures
from benchmarks.imperfect.cases import CASES, Case, corrects, without
from benchmarks.imperfect.rig import ImperfectRig
from benchmarks.imperfect.study import Outcome, measure_case, quick_cases, run_cases, write_outcomes
from benchmarks.imperfect.survey import CALIBRATED, DISTANCES, Surveyed, markdown, read_survey, write_survey
from napari_elsplus.processing.calibration.calibrate import measure
from napari_elsplus.processing.calibration.measurements import measure_pair
from napari_elsplus.processing.calibration.steps import find_step
from napari_elsplus.processing.images.sectioning import Sectioner
from napari_elsplus.simulation import calibration_scenes
from napari_elsplus.simulation.calibration_scenes import transmission
from napari_elsplus.simulation.model.imperfections import Imperfections
from napari_elsplus.simulation.specimen.scenes import uniform
from napari_elsplus.simulation.truth import true_calibration


def test_cases_name_imperfections_that_exist_and_each_once() -> None:
    for case in CASES:
        assert Imperfections.parse(case.imperfections).changed, case.name
    assert len({(case.imperfections, case.preset, case.quantity.name) for case in CASES}) == len(CASES)


def test_the_true_calibration_of_an_undistorted_rig_leaves_nothing_over() -> None:
    rig = ImperfectRig.of("240hz")
    found = measures.misalignment(rig, true_calibration(rig.instrument))
    assert found.left_over_px < 1e-9
    level = ImperfectRig.of("240hz", line_tilt_deg=0.0)
    assert measures.true_offset_rows(level) == pytest.approx(level.instrument.offset_rows, abs=0.02)


def test_the_ideal_rig_itself_has_the_distances_of_its_line_and_a_halo_in_collection_shortens_them() -> None:
    rows = np.arange(524.0)
    ideal = measures.own_distances_um(ImperfectRig.of("240hz"), rows)
    assert ideal == pytest.approx((35.0, 119.9), rel=0.02)  # of the closed form, whose bundle has no rim
    halo = measures.own_distances_um(ImperfectRig.of("240hz", Imperfections.parse("halo-in-collection=40")), rows)
    assert all(0.97 < one / other < 0.995 for one, other in zip(halo, ideal, strict=True))


@pytest.mark.parametrize("distortion", [0.0, 0.5, -0.5])
def test_the_true_gain_is_the_brightness_of_the_views_where_one_is_distorted(distortion: float) -> None:
    """Its cores lie closer together in some parts, which are brighter: by 0.16 % over nine tenths of the bundle."""
    rig = ImperfectRig.of("240hz", Imperfections(right_distortion_percent=distortion))
    pair = measure_pair(list(transmission(rig.instrument))[:2])
    assert measures.true_gain(rig) == pytest.approx(pair.alignment.gain, abs=3e-4)


@pytest.mark.parametrize("percent", [0.6, -0.6])
def test_the_galvo_map_is_judged_by_the_row_on_which_a_distorting_lens_shows_the_line(percent: float) -> None:
    """The lens displaces the middle of the view, by which the map was said to be 0.02 rows off."""
    rig = ImperfectRig.of("240hz", Imperfections(lens_distortion_percent=percent))
    error = measures.galvo_error(rig, rig.measured)
    assert abs(error.off) < 3 * error.stated < 0.02


@pytest.mark.parametrize("percent", [1.75, -1.75])
def test_the_slit_offset_is_judged_at_the_middles_of_views_that_a_distorting_lens_displaces(percent: float) -> None:
    """Two pixels from the central cores, one to the left and one to the right: 0.01 rows along a tilted line."""
    rig = ImperfectRig.of("240hz", Imperfections(lens_distortion_percent=percent))
    volts = np.full(find_step("offset").frames, calibration_scenes.line_volts(rig.instrument)[0])
    line, dark = rig.line_frames(volts, 1), list(calibration_scenes.dark_tube(rig.instrument, seed=2))
    bundle = list(calibration_scenes.transmission(rig.instrument, seed=3))
    error = measures.offset_error(rig, measure(line=line, bundle=bundle, background=dark).calibration)
    assert abs(error.off) < 3 * error.stated < 0.008


def test_rigs_drawn_at_random_differ_in_the_noise_of_their_recordings() -> None:
    rigs = [ImperfectRig.drawn("240hz", seed) for seed in (1, 2)]
    assert rigs[0].recording_seed("line") != rigs[1].recording_seed("line")


def test_a_line_on_its_slit_is_judged_perfect_and_a_late_one_is_not() -> None:
    rig = ImperfectRig.of("240hz")
    rows = np.arange(524.0)
    assert measures.scanned(rig, rows) == (0, 1.0)
    off, signal = measures.scanned(rig, rows + 3.0)
    assert off > 480
    assert 0.6 < signal < 0.9


def marked(case: Case) -> object:
    marks = pytest.mark.slow if case.preset == "120hz" else ()
    return pytest.param(case, marks=marks, id=f"{case.imperfections} {case.quantity.name}")


@pytest.mark.parametrize("case", [marked(case) for case in quick_cases()])
def test_the_quick_cases_are_measured_and_disturb_or_are_corrected(case: Case) -> None:
    outcome = measure_case(case)
    assert np.isfinite(outcome.clean)
    assert outcome.holds or outcome.refused or outcome.disturbed != outcome.clean


def test_a_correction_switched_off_leaves_a_calibration_that_images_can_be_made_with() -> None:
    rig = ImperfectRig.of("240hz")
    distorted = true_calibration(rig.instrument).model_copy(
        update={"distortion": np.full((2, 10), 0.5, np.float32), "version": 2}
    )
    assert corrects(distorted, ("distortion",))
    plain = without(distorted, ("distortion",))
    assert not corrects(plain, ("distortion",))
    raw = rig.renderer(uniform()).render(0)
    images = [Sectioner(one, raw.shape).residual(raw) for one in (plain, true_calibration(rig.instrument))]
    assert (images[0] == images[1]).all()


def test_a_survey_counts_refused_wrong_and_warned_rigs_and_is_resumed_from_its_file(tmp_path: Path) -> None:
    good = dict.fromkeys((*CALIBRATED, *DISTANCES), measures.Error(0.0, 1.0))
    bad = good | {"ELS+ 10 dB": measures.Error(12.0, 1.0)}
    near, far = measures.Error(0.0, 0.01), measures.Error(0.1, 0.01)
    rigs = [
        Surveyed(1, good, {"ELS+ 3 dB": near, "ELS+ 10 dB": near}),
        Surveyed(2, bad, {"ELS+ 3 dB": near, "ELS+ 10 dB": far}),
        Surveyed(3, refused="no line"),
        Surveyed(4, bad, {"ELS+ 3 dB": near, "ELS+ 10 dB": far}, warning="rows miss the slit"),
    ]
    text = markdown(rigs)
    assert "4 rigs drawn at random (seeds 1 to 4): 1 refused; of the others 2 with an ELS+ drop-off" in text
    assert "of which 1 were warned of, and 1 silently" in text
    write_survey(rigs, tmp_path / "rigs.csv")
    assert markdown(read_survey(tmp_path / "rigs.csv")) == text


def test_cases_that_a_table_has_are_not_measured_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    case = quick_cases()[0]
    known = Outcome(case, 1.0, 2.0, 3.0, "")
    write_outcomes([known], tmp_path / "imperfect.csv")
    monkeypatch.setattr("benchmarks.imperfect.study.measure_case", lambda _: pytest.fail("measured again"))
    again = run_cases([case], tmp_path / "imperfect.csv")
    assert [one.cells() for one in again] == [known.cells()]


def test_the_command_writes_table_and_chart(bench_program, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(
        "benchmarks.imperfect.study.quick_cases", lambda: [case for case in quick_cases() if case.preset == "240hz"]
    )
    folder = tmp_path / "new"
    run = bench_program("imperfect", "--quick", "--out", folder)
    assert run.code == 0
    with (folder / "imperfect.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 1
    assert (folder / "imperfect.png").read_bytes().startswith(b"\x89PNG")
    assert "aims are reached" in run.out
