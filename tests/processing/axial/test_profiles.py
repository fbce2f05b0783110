"""Scans of a plate by a few lines of closed form, none of the package's model: a line of core and halo on a bundle."""

from __future__ import annotations

import numpy as np
import pytest

from napari_elsplus.errors import MeasurementError
from napari_elsplus.instrument.calibration import Calibration
from napari_elsplus.processing.axial.axial_notes import axial_notes
from napari_elsplus.viewing.axial import ManualScan
from napari_elsplus.workflows.axial import measure_axial_response

OFFSET_UM, GAIN, BLACK_DN = 29.0, 0.85, 5.0
CENTRES, DIAMETER_PX, SHAPE = ((110.0, 110.0), (106.0, 330.0)), 200.0, (220, 440)
DEPTH_UM = np.r_[np.arange(0, 40, 2), np.arange(40, 200, 5), np.arange(200, 700, 10)].astype(float)


def signal(offset_um: float, depth_um: np.ndarray) -> np.ndarray:
    """Light at an offset from the line: two Gaussians, widened by defocus."""
    defocus_um = 0.236 * (np.abs(depth_um) + 14.3)
    widths_um = [(0.348, np.hypot(5.43, defocus_um)), (0.652, np.hypot(34.8, defocus_um))]
    return sum(part / width * np.exp(-(offset_um**2) / 2 / width**2) for part, width in widths_um)


def truth_um() -> list[float]:
    """Distances at which LS and ELS+ fall to a half and a tenth, on a fine grid."""
    depth_um = np.linspace(0, 900, 90001)
    ls = signal(0.0, depth_um)
    els = ls - signal(OFFSET_UM, depth_um)
    return [float(depth_um[np.argmax(curve < level * curve[0])]) for curve in (ls, els) for level in (0.5, 0.1)]


def bundle(random: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Images of both views of a lit bundle: uneven cores, and the same of them in both."""
    rows, cols = np.mgrid[: SHAPE[0], : SHAPE[1]]
    cores = np.clip(random.normal(1, 0.15, (70, 70)), 0.3, 2)
    views = []
    for row, col in CENTRES:
        away = np.hypot(rows - row, cols - col) < DIAMETER_PX / 2
        y, x = (rows - row) + 105, (cols - col) + 105
        light = (0.6 + 0.4 * np.cos(2 * np.pi * y / 3) * np.cos(2 * np.pi * x / 3)) * away
        views.append(light * cores[np.clip(y // 3, 0, 69).astype(int), np.clip(x // 3, 0, 69).astype(int)])
    return views[0], GAIN * views[1]


def scan(
    peak_dn: float,
    depth_um: np.ndarray = DEPTH_UM,
    *,
    black_dn: float | np.ndarray = BLACK_DN,
    haze: float = 0.0,
    seed: int = 0,
    offset_um: float = OFFSET_UM,
) -> np.ndarray:
    """Raw 8-bit frames, one at each depth, with shot and read noise; haze is scattered light about the discs."""
    random = np.random.default_rng(seed)
    confocal, residual = bundle(random)
    rows, cols = np.ogrid[: SHAPE[0], : SHAPE[1]]
    away = [np.hypot(rows - row, cols - col) / DIAMETER_PX for row, col in CENTRES]
    around = haze * sum(np.exp(-3 * np.maximum(each - 0.5, 0)) for each in away)
    frames = []
    for at_um, black in zip(depth_um, np.broadcast_to(black_dn, len(depth_um)), strict=True):
        light = peak_dn / signal(0.0, np.array(0.0)) * np.array([signal(each, at_um) for each in (0.0, offset_um)])
        image = light[0] * confocal + light[1] * residual + light.mean() * around
        noisy = random.poisson(20 * image) / 20 + random.normal(0, 0.5, SHAPE)
        frames.append(np.clip(np.round(noisy + black), 0, 255).astype(np.uint8))
    return np.array(frames)


def calibration(*, background: bool = True) -> Calibration:
    (row, col), (other_row, other_col) = CENTRES
    record = {
        "bundle": {
            "confocal_centre": [row, col],
            "residual_centre": [other_row, other_col],
            "diameter_px": DIAMETER_PX,
            "residual_to_confocal": [[1, 0, row - other_row], [0, 1, col - other_col]],
            "residual_gain": GAIN,
        },
        "optics": {"um_per_px": 3.1},
    }
    known = Calibration.parse(record)
    if not background:
        return known
    dark = np.random.default_rng(99).normal(BLACK_DN, 0.5, (20, *SHAPE)).round().mean(axis=0)
    return known.model_copy(update={"background": dark.astype(np.float32)})


def drops_um(response: object) -> list[float]:
    return [getattr(response, name).um for name in ("ls_3db", "ls_10db", "els_3db", "els_10db")]


def test_a_scan_of_a_plate_gives_the_distances_of_its_light() -> None:
    assert drops_um(measure_axial_response(scan(150.0), calibration(), DEPTH_UM)) == pytest.approx(truth_um(), rel=0.01)


@pytest.mark.parametrize("peak_dn", [240.0, 400.0])
def test_a_scan_that_is_saturated_in_contact_is_refused_with_its_depths(peak_dn: float) -> None:
    """LS 3 dB was 128 um instead of 57 um, with an uncertainty of 0.03 um."""
    there_and_back = np.r_[DEPTH_UM, DEPTH_UM[::-1]]
    with pytest.raises(MeasurementError, match=r"saturated .* 0 to \d+ um") as refused:
        measure_axial_response(scan(peak_dn, there_and_back), calibration(), there_and_back)
    assert "lower the light" in str(refused.value)


def test_hot_pixels_do_not_refuse_a_scan() -> None:
    """Of eight rows of the square, that with the largest share counted: one hot pixel of its 77 was 1.3 %."""
    frames = scan(100.0)
    frames[:, [71, 100, 148], [100, 90, 80]] = 255
    response = measure_axial_response(frames, calibration(), DEPTH_UM)
    assert response.els_3db.um == pytest.approx(truth_um()[2], rel=0.05)


def test_a_few_bright_cores_that_are_clipped_in_contact_do_not_refuse_a_scan() -> None:
    """A scan with 0.2 % of its square saturated in contact was refused."""
    frames = scan(195.0)
    assert np.mean(frames[0][71:149, 71:149] == 255) > 0.003
    assert drops_um(measure_axial_response(frames, calibration(), DEPTH_UM)) == pytest.approx(truth_um(), rel=0.01)


def test_a_saturated_frame_is_no_step_of_a_manual_scan() -> None:
    steps, frames = ManualScan(), scan(400.0, np.array([0.0, 600.0]))
    steps.take(frames[1], calibration(), 600.0)
    with pytest.raises(MeasurementError, match="saturated at 0 um"):
        steps.take(frames[0], calibration(), 0.0)
    assert steps.depth_um == [600.0]


@pytest.mark.parametrize(
    ("change_dn", "haze", "background", "seed"),
    [(3.0, 0.0, True, 0), (-2.0, 0.0, True, 1), (0.4, 0.03, True, 2), (0.0, 0.0, False, 3), (0.0, 0.03, False, 4)],
)
def test_a_black_level_that_is_not_the_backgrounds_is_corrected_and_noted(
    change_dn: float, haze: float, background: bool, seed: int
) -> None:
    """LS 10 dB was 679 um with 3 grey levels more, and beyond the scan without a background."""
    known = calibration(background=background)
    frames = scan(150.0, black_dn=BLACK_DN + change_dn, haze=haze, seed=seed)
    response = measure_axial_response(frames, known, DEPTH_UM)
    # Haze is in the views, too, and moves the distances.
    steady = measure_axial_response(scan(150.0, haze=haze, seed=seed), calibration(), DEPTH_UM)
    assert drops_um(response) == pytest.approx(drops_um(steady) if haze else truth_um(), rel=0.005)
    note = axial_notes(response)[0]
    assert note.startswith("warning: the black level changed" if background else "warning: the calibration has no")
    wanted = change_dn if background else BLACK_DN
    assert response.content()["black_level_subtracted_dn"] == pytest.approx(wanted, abs=0.02)


@pytest.mark.parametrize("drift_dn", [-3.0, 2.5])
@pytest.mark.parametrize("haze", [0.0, 0.03])
def test_a_black_level_that_drifts_over_the_scan_is_corrected_in_each_frame(drift_dn: float, haze: float) -> None:
    """One level was subtracted from all frames: of three rigs LS 3 dB was off by 7 to 10 standard deviations."""
    drift = np.linspace(0, drift_dn, len(DEPTH_UM))
    response = measure_axial_response(scan(150.0, black_dn=BLACK_DN + drift, haze=haze), calibration(), DEPTH_UM)
    steady = measure_axial_response(scan(150.0, haze=haze), calibration(), DEPTH_UM)
    assert drops_um(response) == pytest.approx(drops_um(steady), rel=0.01)
    assert response.content()["black_level_subtracted_dn"] == pytest.approx(drift_dn / 2, abs=0.05)


def test_light_that_is_scattered_beside_the_views_is_no_black_level() -> None:
    for haze in (0.0, 0.02, 0.1):
        response = measure_axial_response(scan(150.0, haze=haze), calibration(), DEPTH_UM)
        assert response.content()["black_level_subtracted_dn"] == 0
        assert not any("black" in note for note in axial_notes(response))


def test_a_manual_scan_without_a_background_is_corrected_too() -> None:
    steps, known, depths = ManualScan(), calibration(background=False), DEPTH_UM[::2]
    for depth_um, frame in zip(depths, scan(150.0, depths), strict=True):
        steps.take(frame, known, depth_um)
    assert drops_um(steps.scan(known).response) == pytest.approx(truth_um(), rel=0.01)


@pytest.mark.parametrize("depths_um", [-DEPTH_UM, DEPTH_UM[::-1].copy()])
def test_depths_of_the_other_sign_or_order_are_refused(depths_um: np.ndarray) -> None:
    """All four distances were missing, without an error."""
    with pytest.raises(MeasurementError, match=r"largest at the last depth, \d+ um.*grow away from the probe"):
        measure_axial_response(scan(150.0), calibration(), depths_um)


@pytest.mark.parametrize("depths_um", [DEPTH_UM, DEPTH_UM[:16:4]])
def test_pixels_beside_the_views_that_are_lit_like_them_show_no_black_level(depths_um: np.ndarray) -> None:
    """The discs of the calibration are smaller than the light."""
    frames = scan(150.0, depths_um)
    small = calibration()
    small = small.model_copy(update={"bundle": small.measured_bundle.model_copy(update={"diameter_px": 120.0})})
    beside = frames.copy()
    beside[:, :, :220] = frames[:, 60:160, 60:160].mean(axis=(1, 2))[:, None, None].astype(np.uint8)
    beside[:, :, 220:] = frames[:, 60:160, 280:380].mean(axis=(1, 2))[:, None, None].astype(np.uint8)
    assert measure_axial_response(beside, small, depths_um).content()["black_level_subtracted_dn"] == 0


@pytest.mark.parametrize("seed", range(3))
def test_els_of_a_residual_slit_on_the_line_is_noise_and_refused(seed: int) -> None:
    """A 3 dB distance of 87 um was given, uncertain by 209 um."""
    depths = DEPTH_UM[::2]
    with pytest.raises(MeasurementError, match="its uncertainty"):
        measure_axial_response(scan(150.0, depths, offset_um=0.0, seed=seed), calibration(), depths)


def test_els_of_a_small_offset_is_measured() -> None:
    found = measure_axial_response(scan(150.0, offset_um=3.0), calibration(), DEPTH_UM)
    assert found.signal_kept == pytest.approx(1 - signal(3.0, np.array(0.0)) / signal(0.0, np.array(0.0)), rel=0.02)
