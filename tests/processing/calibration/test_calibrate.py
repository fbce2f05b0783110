"""All steps together: true on rigs drawn at random, sure of itself to the right degree, and clear about bad input."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from benchmarks.documents.calibration_accuracy import FIRST_SEED
from benchmarks.rigs.random_rigs import Rig
from benchmarks.studies.calibration_accuracy import ALIGNMENT, CENTRE, DIAMETER, GAIN, LAG, OFFSET, SLOPE, survey
from napari_elsplus.errors import CalibrationError, ElsPlusError, InputError, MeasurementError
from napari_elsplus.processing.calibration.calibrate import measure
from napari_elsplus.processing.calibration.measurements import (
    map_galvo,
    mean_frame,
    measure_background,
    measure_flat_field,
)
from napari_elsplus.processing.calibration.slit_offset import measure_offset
from napari_elsplus.processing.images.sectioning import Sectioner, disc
from napari_elsplus.simulation.calibration_scenes import line_volts, standing_line, transmission
from napari_elsplus.simulation.model.imperfections import Imperfections
from napari_elsplus.simulation.model.instrument import Instrument

RIG = Rig(left=(112.0, 103.0), right=(98.4, 318.7), diameter_px=190.0, tilt_deg=1.5, gain=0.93, volts_per_row=-0.0012)


def test_random_rigs_are_calibrated_within_the_aims() -> None:
    found = survey([Rig.draw(seed) for seed in (700, 701)], voltages=40)
    assert found.refused == []
    for quantity, accuracy in found.accuracies.items():
        assert accuracy.rms < 2 * quantity.bar, quantity.name
        assert accuracy.within(4) == 1, quantity.name


@pytest.mark.slow
def test_two_hundred_rigs_are_within_the_aims_and_the_stated_uncertainties() -> None:
    found = survey([Rig.draw(FIRST_SEED + number) for number in range(200)], voltages=400, processes=2)
    assert found.refused == []
    for quantity, accuracy in found.accuracies.items():
        assert accuracy.rms <= quantity.bar, quantity.name
    for quantity in (OFFSET, SLOPE, CENTRE, DIAMETER, ALIGNMENT, GAIN, LAG):
        assert found.accuracies[quantity].within(3) >= 0.98, quantity.name
        assert 0.60 <= found.accuracies[quantity].within(1) <= 0.76, quantity.name


@pytest.mark.parametrize("down", [False, True])
def test_offset_has_its_sign_and_tilt_does_not_bias_it(down: bool) -> None:
    rig = replace(RIG, right=(128.3, 318.7)) if down else RIG
    frames = rig.line(3)
    alone = measure_offset(frames)
    section = measure(line=frames, bundle=rig.bundle()).calibration.offset
    assert section is not None
    assert alone.rows == pytest.approx(rig.offset_rows(1.3), abs=0.08)
    assert section.rows == pytest.approx(rig.offset_rows(0.0), abs=0.05)
    assert section.rows > 0 if down else section.rows < 0
    assert section.tilt_deg == pytest.approx(rig.tilt_deg, abs=0.15)


@pytest.mark.parametrize("vignette", [10, -10])
def test_offset_of_a_bowed_line_is_not_biased_by_a_vignette(vignette: int) -> None:
    """The straight lines through a bow of 3 rows differed in height by 0.065 rows where one view is dimmer outside."""
    given = Imperfections.parse(f"line-bow=3,right-vignette={vignette}")
    instrument = Instrument.of("240hz", imperfections=given)
    lines = list(standing_line(instrument, line_volts(instrument)[:3]))
    section = measure(line=lines, bundle=list(transmission(instrument))[:2]).calibration.offset
    assert section is not None
    assert section.rows == pytest.approx(instrument.offset_rows, abs=0.025)


@pytest.mark.parametrize("imperfections", ["power-ripple=4,ripple-frequency=3600", "power-noise=5", "row-noise=2"])
def test_an_offset_is_taken_from_the_cores_where_noise_of_the_rows_moves_the_line(imperfections: str) -> None:
    """A ripple in step with the frames moved line and offset by 0.2 rows, in all of them; power noise by 0.04."""
    instrument = Instrument.of("240hz", imperfections=Imperfections.parse(imperfections))
    volts = np.full(10, line_volts(instrument)[0])
    lines, bundle = list(standing_line(instrument, volts)), list(transmission(instrument))[:2]
    draft = measure(line=lines, bundle=bundle)
    section = draft.calibration.offset
    assert section is not None
    assert draft.offset is not None
    assert section.rows == draft.offset.rows
    assert section.rows == pytest.approx(instrument.offset_rows, abs=0.01)
    assert section.uncertainty_rows < 0.01
    assert abs(section.rows - instrument.offset_rows) < 3 * section.uncertainty_rows


@pytest.mark.parametrize("rows", [0.7, 4.0])
def test_an_offset_is_taken_from_the_line_where_the_mirror_was_turned_since_the_pair(rows: float) -> None:
    instrument = Instrument.of("240hz")
    turned = replace(instrument, offset_rows=instrument.offset_rows + rows)
    lines, bundle = list(standing_line(turned, line_volts(turned)[:3])), list(transmission(instrument))[:2]
    draft = measure(line=lines, bundle=bundle)
    after = draft.calibration.offset
    assert "the offset has moved" in draft.outdated["pair"]
    assert after is not None
    assert after.rows == pytest.approx(turned.offset_rows, abs=0.02)
    assert after.uncertainty_rows < 0.1


def test_galvo_rows_are_taken_at_the_confocal_centre_with_or_without_its_image() -> None:
    volts = RIG.volts(60)
    sweep = RIG.sweep(volts)
    alone = map_galvo(sweep, volts)
    section = measure(sweep=sweep[::-1], volts=volts[::-1], bundle=RIG.bundle()).calibration.galvo
    assert section is not None
    for slope, at_zero in (
        (alone.volts_per_row, alone.volts_at_row_zero),
        (section.volts_per_row, section.volts_at_row_zero),
    ):
        assert slope == pytest.approx(RIG.volts_per_row, rel=1e-3)
        assert (at_zero - RIG.volts_at_row_zero) / RIG.volts_per_row == pytest.approx(0, abs=0.2)
    assert section.park_v is not None
    clear_px = 100 / (620 / RIG.diameter_px)
    assert abs(section.row(section.park_v) - RIG.left[0]) > RIG.diameter_px / 2 + clear_px


def test_flat_field_has_mean_one_and_takes_the_illumination_away() -> None:
    rig = replace(RIG, uneven=0.4)
    calibration = measure(bundle=rig.bundle(4)).calibration
    assert calibration.flat is not None
    inside = disc(len(calibration.flat), 0.9 * rig.diameter_px)
    assert calibration.flat[inside].mean() == pytest.approx(1, abs=0.05)
    again = Sectioner(calibration, rig.shape).ls(mean_frame(rig.bundle(4)) - rig.black_dn)
    flattened = again[inside] / calibration.flat[inside]
    assert flattened.std() / flattened.mean() < 0.3 * again[inside].std() / again[inside].mean()
    with pytest.raises(MeasurementError, match="flat field is dark"):
        measure_flat_field(np.zeros((1, *rig.shape)), calibration)
    lit = rig.bundle(4)
    with pytest.raises(MeasurementError, match=r"\d+ % of the flat field is saturated"):
        measure_flat_field(np.where(lit > 40, 255, lit).astype(np.uint8), calibration)
    with pytest.raises(MeasurementError, match="the flat field drifts by -"):
        measure_flat_field(lit * np.array([1, 1, 0.8, 0.8])[:, None, None], calibration)
    with pytest.raises(CalibrationError, match="no bundle section"):
        measure_flat_field(rig.bundle(), measure(line=rig.line()).calibration)


def test_a_saturated_patch_has_no_say_in_gain_or_flat_field() -> None:
    """A hot spot of the lamp: in the patch both views are white, and the darker one looks as bright as the other."""
    spot = 1 + 6 * np.exp(-np.square(RIG.cores - (20, -30)).sum(1) / (2 * 11.0**2))
    frames = np.clip(RIG.lit_from_far_end(spot) / RIG.electrons_per_dn + RIG.black_dn, 0, 255).astype(np.uint8)[None]
    found = measure(bundle=frames)
    assert found.pair is not None
    assert 0.01 < found.pair.saturated < 0.05
    assert found.calibration.flat is None
    assert found.pair.alignment.gain == pytest.approx(RIG.gain, abs=0.002)
    assert found.calibration.quality is not None
    with pytest.raises(MeasurementError, match=r"\d+ % of the image of the bundle is saturated"):
        measure(bundle=np.where(frames > 60, 255, frames).astype(np.uint8))


def test_a_structured_target_gives_no_flat_field_and_the_sweep_one_instead() -> None:
    """Squares of a tenth of the light, by which images would be divided: tracking then followed the squares."""
    even, (y, x) = measure(bundle=RIG.bundle(4)).calibration.flat, RIG.cores.T
    squares = np.where(np.sin(y / 7) * np.sin(x / 9) > 0, 1, 0.1)
    lit = RIG.lit_from_far_end(squares) / RIG.electrons_per_dn + RIG.black_dn
    frames = np.repeat(np.clip(lit, 0, 255).astype(np.uint8)[None], 2, axis=0)
    assert measure(bundle=frames).calibration.flat is None
    volts = RIG.volts(150)
    flat = measure(bundle=frames, line=RIG.line(), sweep=RIG.sweep(volts), volts=volts).calibration.flat
    assert even is not None
    assert flat is not None
    inside = disc(len(even), 0.9 * RIG.diameter_px)
    assert np.corrcoef(flat[inside], even[inside])[0, 1] > 0.97
    assert flat[inside].mean() == pytest.approx(1, abs=0.05)


def test_a_given_flat_field_of_a_structured_target_is_not_used() -> None:
    """That of the bundle pair is kept."""
    y, x = RIG.cores.T
    squares = RIG.lit_from_far_end(np.where(np.sin(y / 7) * np.sin(x / 9) > 0, 1, 0.1))
    frames = np.repeat((squares / RIG.electrons_per_dn + RIG.black_dn)[None], 2, axis=0)
    even, structured = measure(bundle=RIG.bundle(4)), measure(bundle=RIG.bundle(4), flat=frames)
    np.testing.assert_array_equal(structured.calibration.flat, even.calibration.flat)


def test_views_cancel_better_after_the_core_filter() -> None:
    quality = measure(bundle=RIG.bundle(4)).calibration.quality
    assert quality is not None
    assert quality.alignment_error_filtered < 0.5 * quality.alignment_error < 0.05


def test_background_is_the_mean_and_drift_is_told() -> None:
    frames = RIG.background(20)
    found = measure_background(frames)
    assert np.allclose(found.mean, frames.mean(axis=0), atol=1e-4)
    assert (found.frames, found.mean.dtype) == (20, np.float32)
    drifting = frames + np.linspace(0, 3, 20)[:, None, None]
    with pytest.raises(MeasurementError, match=r"background drifts by \d+\.\d %"):
        measure_background(drifting)
    with pytest.raises(MeasurementError, match=r"background drifts by \d+\.\d %"):
        measure_background(drifting[::10])
    with pytest.raises(MeasurementError, match="100 % of the background is saturated"):
        measure_background(np.full((5, 40, 60), 255, np.uint8))


def test_light_that_flickers_is_no_drift() -> None:
    """Of ten frames whose light scatters by 6 % the halves differ by more than a drift may, in a fifth of all."""
    steady = RIG.background(10).astype(np.float64)
    for seed in range(40):
        light = np.random.default_rng(seed).normal(1, 0.06, 10)
        measure_background(steady * light[:, None, None])
    with pytest.raises(MeasurementError, match="background drifts by"):
        measure_background(steady * (light + np.linspace(0, 1, 10))[:, None, None])


def test_background_that_is_given_is_used_by_line_and_sweep() -> None:
    """A lamp left on draws a brighter line than the laser's; only the background frame tells them apart."""
    lamp = np.zeros(RIG.shape, np.uint8)
    lamp[60:66, round(RIG.left[1]) - 90 : round(RIG.right[1]) + 90] = 100
    line, dark = RIG.line() + lamp, RIG.background(10) + lamp
    found = measure(line=line, background=dark).offset
    assert found is not None
    assert found.rows == pytest.approx(RIG.offset_rows(1.3), abs=0.08)
    assert abs(measure_offset(line).rows - RIG.offset_rows(1.3)) > 1


@pytest.mark.parametrize(
    ("inputs", "word"),
    [
        ({"line": np.zeros((0, 40, 60))}, "line: there are 0 frames"),
        ({"line": np.zeros((2, 40, 60, 3))}, r"line: a frame has shape \(40, 60, 3\)"),
        ({"line": np.zeros((1, 40, 60)), "bundle": np.zeros((1, 41, 60))}, "line has 40 x 60 pixels, bundle 41 x 60"),
        ({"sweep": np.zeros((3, 40, 60))}, "a sweep without voltages"),
        ({"volts": np.zeros(3)}, "voltages without a sweep"),
        ({"sweep": np.zeros((3, 40, 60)), "volts": np.zeros(4)}, "4 voltages for 3 frames"),
        ({"um_per_px": 1.0, "bundle_um": 620.0}, "two scales"),
        ({"bundle_um": 620.0}, "gives no scale without its image"),
        ({"flat": np.ones((1, 40, 60))}, "flat field belongs to a located bundle"),
        ({"um_per_px": -1.0}, "um_per_px is -1"),
        ({"bundle_um": -5.0, "bundle": np.zeros((1, 40, 60))}, "a bundle of -5 um across"),
        ({"bundle_um": float("nan"), "bundle": np.zeros((1, 40, 60))}, "a bundle of nan um across"),
        (
            {"bundle_um": 0.62, "bundle": np.zeros((1, 40, 60))},
            "a bundle of 0.62 um across: give .* in micrometres, 50",
        ),
        ({"bundle_um": 6.2e5, "bundle": np.zeros((1, 40, 60))}, "a bundle of 620000 um across"),
        ({"um_per_px": 1e308}, r"um_per_px is 1e\+308: give the micrometres"),
        ({"um_per_px": 1e-308}, "um_per_px is 1e-308"),
        ({"line_period_s": 7.6}, "line_period_s is 7.6: give the seconds from one row to the next"),
        ({"line_period_s": 1e-12}, "line_period_s is 1e-12"),
        ({"line_periods_per_frame": 1e9}, r"rows_per_frame is 1e\+09: count all line periods"),
        ({"line_period_s": float("nan")}, "line_period_s is nan"),
        ({"line_periods_per_frame": 39.0, "line": np.zeros((1, 40, 60))}, "39 rows per frame, but frames have 40 rows"),
        ({"line": np.full((1, 40, 60), np.nan)}, "NaN or infinity"),
    ],
)
def test_inputs_that_make_no_sense_are_told(inputs: dict[str, object], word: str) -> None:
    with pytest.raises(InputError, match=word):
        measure(**inputs)  # type: ignore[arg-type]


frames = hnp.arrays(
    st.sampled_from([np.uint8, np.uint16, np.float32, np.bool_]),
    st.tuples(st.integers(1, 3), st.integers(1, 60), st.integers(1, 90)),
    elements=st.integers(0, 1),
)


@given(frames=frames, height=st.sampled_from([1, 50, 200]))
@settings(max_examples=60, deadline=None)
def test_no_frames_whatsoever_end_in_anything_but_a_clear_error(frames: np.ndarray, height: int) -> None:
    frames = frames * np.array(height, np.uint8 if frames.dtype == np.uint8 else np.float32)
    said = []
    for inputs in (
        {"line": frames},
        {"bundle": frames},
        {"sweep": frames, "volts": np.arange(len(frames))},
        {"background": frames},
    ):
        try:
            measure(**inputs)  # type: ignore[arg-type]
        except ElsPlusError as error:
            said.append(str(error))
    assert all(len(line.splitlines()) == 1 for line in said)
