"""Saturated frames are found whatever container they are in, and spoil no number that is stated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.rigs.random_rigs import Rig
from napari_elsplus.errors import MeasurementError
from napari_elsplus.processing.analysis.saturation import saturation_level
from napari_elsplus.processing.calibration.calibrate import measure
from napari_elsplus.processing.calibration.draft import Draft, Setup
from napari_elsplus.processing.calibration.measurements import measure_background, measure_pair
from napari_elsplus.processing.calibration.steps import find_step

RIG = Rig(left=(112.0, 103.0), right=(98.4, 318.7), diameter_px=190.0, tilt_deg=0.5, gain=0.87)
HALO = replace(RIG, line_rows=2.6, halo_rows=12.0, halo_share=0.4)


def camera(
    electrons: np.ndarray, count: int = 1, *, peak: float = 120.0, bits: int = 8, shift: int = 0, seed: int = 1
) -> np.ndarray:
    """Frames (count, rows, cols) of a camera that clips, of 8 bits in uint8, of more in uint16, shifted to the left.

    `peak` are the grey levels of the brightest pixel of an evenly lit bundle.
    """
    random, per_dn = np.random.default_rng(seed), RIG.photons / peak
    seen = random.poisson(np.repeat(electrons[None], count, axis=0)) + random.normal(0, 4, (count, *electrons.shape))
    levels = np.clip(np.rint(seen / per_dn) + 5, 0, 2**bits - 1)
    return levels.astype(np.uint8) if bits == 8 else levels.astype(np.uint16) << shift


@pytest.mark.parametrize(("bits", "shift"), [(8, 0), (10, 0), (12, 0), (12, 4), (14, 2), (16, 0)])
def test_saturated_frames_are_refused_whatever_the_container(bits: int, shift: int) -> None:
    """Only the container's largest level counted: 12 bits in 16 never reach it."""
    white = (2**bits - 1) << shift
    bundle = camera(RIG.lit_from_far_end(), 2, peak=1.5 * 2**bits, bits=bits, shift=shift)
    assert saturation_level(bundle[0]) == white
    with pytest.raises(MeasurementError, match=rf"the image of the bundle is saturated \(grey level {white}\)"):
        measure(bundle=bundle)
    line = camera(RIG.lit_by_line(1.3), 2, peak=8 * 2**bits, bits=bits, shift=shift)
    with pytest.raises(MeasurementError, match="the image of the line is saturated"):
        measure(line=line)


@pytest.mark.parametrize(("bits", "shift"), [(8, 0), (12, 0), (12, 4), (16, 0)])
@pytest.mark.parametrize("share", [0.1, 0.4])
def test_ordinary_frames_are_not_saturated(bits: int, shift: int, share: float) -> None:
    bundle = camera(RIG.lit_from_far_end(), 2, peak=share * 2**bits, bits=bits, shift=shift)
    line = camera(RIG.lit_by_line(1.3), 2, peak=share * 2**bits, bits=bits, shift=shift)
    found = measure(bundle=bundle, line=line)
    assert found.pair is not None
    assert found.pair.saturated == 0
    assert found.calibration.flat is not None


@pytest.mark.parametrize("top", [255, 1023, 4095])
@pytest.mark.parametrize("dtype", [np.uint16, np.int16, np.float32])
def test_the_brightest_pixels_of_a_bundle_are_not_saturated_where_they_happen_to_end_a_range(
    top: int, dtype: type
) -> None:
    """A bright bundle's histogram falls towards its largest level; a clipped one's ends in a pile."""
    levels = RIG.lit_from_far_end()
    bright = np.minimum(np.rint(levels * (1.02 * top / levels.max())), top + 1000)
    scaled = np.rint(bright * (top / bright.max())).astype(dtype)
    assert scaled.max() == top
    assert saturation_level(scaled) > top
    clipped = np.minimum(np.rint(1.5 * levels * (top / levels.max())), top).astype(dtype)
    assert saturation_level(clipped) == top


@pytest.mark.parametrize("frame", [np.zeros((9, 9)), np.full((9, 9), np.nan), np.zeros((0, 4)), np.ones((9, 9), bool)])
def test_frames_of_anything_have_a_level_of_white(frame: np.ndarray) -> None:
    assert saturation_level(frame) == np.inf


def sweep(peak: float, volts: np.ndarray, **spread: float) -> np.ndarray:
    """A frame per voltage, the line's power different from frame to frame by a relative spread on request."""
    random = np.random.default_rng(5)
    rows = (volts - RIG.volts_at_row_zero) / RIG.volts_per_row - RIG.left[0]
    power = 1 + spread.get("spread", 0.0) * random.uniform(-1, 1, len(rows))
    return np.concatenate(
        [
            camera(RIG.lit_by_line(row) * each, peak=peak, seed=k)
            for k, (row, each) in enumerate(zip(rows, power, strict=True))
        ]
    )


def warned(draft: Draft, step: str) -> str:
    return "; ".join(find_step(step).summary(draft, draft.found[step], Setup(draft.calibration.frame)).warnings)


@pytest.mark.parametrize("peak", [400.0, 800.0])
def test_a_saturated_sweep_leaves_the_lamps_gain_and_a_true_map(peak: float) -> None:
    """It stated a gain 1.8 to 8 % too large to 0.02 %: the brighter view is clipped more."""
    volts = RIG.volts(60)
    found = measure(bundle=camera(RIG.lit_from_far_end(), 4), sweep=sweep(peak, volts), volts=volts)
    bundle, galvo = found.calibration.bundle, found.calibration.galvo
    assert bundle is not None
    assert galvo is not None
    assert bundle.residual_gain == pytest.approx(RIG.gain, rel=0.001)
    assert bundle.residual_gain_uncertainty == pytest.approx(0.02 * RIG.gain, rel=0.1)
    assert galvo.volts_per_row == pytest.approx(RIG.volts_per_row, rel=1e-3)
    assert "of the sweep, so that it gives no gain of the residual view: the lamp's stays; lower" in warned(
        found, "galvo"
    )


def test_saturated_lines_are_left_out_of_the_gain() -> None:
    volts = RIG.volts(100)
    found = measure(bundle=camera(RIG.lit_from_far_end(), 4), sweep=sweep(270.0, volts, spread=0.4), volts=volts)
    bundle, galvo = found.calibration.bundle, found.galvo
    assert bundle is not None
    assert galvo is not None
    assert galvo.light is not None
    assert 10 < galvo.light.clipped < 50
    assert bundle.residual_gain_uncertainty < 0.003
    assert abs(bundle.residual_gain - RIG.gain) < 3 * bundle.residual_gain_uncertainty + 0.0003
    assert "which are left out of the gain" in warned(found, "galvo")
    whole = measure(bundle=camera(RIG.lit_from_far_end(), 4), sweep=sweep(110.0, volts), volts=volts)
    assert "saturated" not in warned(whole, "galvo")


@pytest.mark.parametrize(("gain", "named"), [(1.04, False), (1.1, True), (1.3, True)])
def test_gains_that_differ_by_more_than_spectra_are_warned_of(gain: float, named: bool) -> None:
    volts, frame = RIG.volts(60), RIG.lit_from_far_end()
    frame[:, frame.shape[1] // 2 :] *= gain
    found = measure(bundle=camera(frame, 4), sweep=sweep(110.0, volts), volts=volts)
    assert ("Record both again" in warned(found, "pair")) == named


def test_saturation_is_searched_beyond_the_first_frame() -> None:
    """One good and nine saturated frames of a line gave a core of 3.5 rows instead of 2.6."""
    good, bright = camera(RIG.lit_by_line(1.3), 1, peak=150.0), camera(RIG.lit_by_line(1.3), 9, peak=2000.0)
    with pytest.raises(MeasurementError, match="the image of the line is saturated"):
        measure(line=np.concatenate([good, bright]))
    good, bright = camera(RIG.lit_from_far_end(), 30), camera(RIG.lit_from_far_end(), 10, peak=400.0)
    with pytest.raises(MeasurementError, match="the image of the bundle is saturated"):
        measure(bundle=np.concatenate([good, bright]))
    with pytest.raises(MeasurementError, match="the background is saturated"):
        measure_background([good[0], *bright[:2], good[1]])


def test_pixels_that_are_saturated_in_most_frames_have_no_say_in_the_gain() -> None:
    """One dim frame among ten hid them in the mean: the gain was 0.4 % too large, of which 0.02 % were stated."""
    dim, bright = camera(RIG.lit_from_far_end(), 1, peak=100.0), camera(RIG.lit_from_far_end(), 9, peak=220.0)
    pair = measure_pair(np.concatenate([dim, bright]))
    assert 0.01 < pair.saturated < 0.05
    assert pair.alignment.gain == pytest.approx(RIG.gain, rel=0.001)


@pytest.mark.parametrize("saturated", [slice(0, 5), slice(1, 5), slice(4, 5)])
def test_a_line_whose_core_is_clipped_has_an_offset_but_no_core(saturated: slice) -> None:
    """A clipped core is half a percent of the frame, which passed: it was stated too wide, and the halo too strong."""
    frames, whole = camera(HALO.lit_by_line(1.3), 5, peak=200.0), measure(line=camera(HALO.lit_by_line(1.3), 5))
    frames[saturated] = camera(HALO.lit_by_line(1.3), 5, peak=480.0)[saturated]
    assert 0.001 < np.mean(frames[4] == 255) < 0.01
    found = measure(line=frames)
    assert whole.offset is not None
    assert whole.offset.parts is not None
    assert "saturated" not in warned(whole, "offset")
    assert found.offset is not None
    assert found.offset.parts is None
    assert found.offset.rows == pytest.approx(HALO.offset_rows(1.3), abs=0.08)
    assert "of the line's core is saturated: core and halo are not measured" in warned(found, "offset")
    paired = measure(line=frames, bundle=camera(HALO.lit_from_far_end(), 2))
    assert "of the line's core is saturated" in warned(paired, "offset")
