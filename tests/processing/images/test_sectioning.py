from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from napari_elsplus.errors import CalibrationError
from napari_elsplus.instrument.calibration import Calibration
from napari_elsplus.processing.images.sectioning import Mode, Sectioner, disc, side_px

SHAPE = (120, 240)
DIAMETER_PX = 90.0
CONFOCAL = (60.3, 58.6)


def calibrated(
    right_to_left: NDArray[np.float64] | None = None, gain: float = 1.0, background: NDArray[np.float32] | None = None
) -> Calibration:
    matrix = np.array([[1, 0, 4.4], [0, 1, -121.7]]) if right_to_left is None else right_to_left
    residual_centre = np.linalg.solve(matrix[:, :2], np.subtract(CONFOCAL, matrix[:, 2]))
    calibration = Calibration.parse(
        {
            "frame": {"shape": SHAPE},
            "bundle": {
                "confocal_centre": CONFOCAL,
                "residual_centre": residual_centre.tolist(),
                "diameter_px": DIAMETER_PX,
                "residual_to_confocal": matrix.tolist(),
                "residual_gain": gain,
            },
        }
    )
    return calibration.model_copy(update={"background": background})


def pattern(row: NDArray[np.float64], col: NDArray[np.float64]) -> NDArray[np.float64]:
    """A scene as the bundle sees it, smooth and dark outside of it; row and col from the bundle's centre."""
    rim = np.clip((DIAMETER_PX / 2 - np.hypot(row, col)) / 14, 0, 1)
    return 100 * rim**2 * (3 - 2 * rim) * (1.2 + np.sin(row / 5) * np.cos(col / 7 + row / 40))


def frame_of(calibration: Calibration, confocal_share: float = 1.0) -> NDArray[np.float64]:
    """A noise-free raw frame in which both views show the pattern, the left one times a factor."""
    assert calibration.bundle is not None
    row, col = np.indices(SHAPE).astype(float)
    left = pattern(row - CONFOCAL[0], col - CONFOCAL[1])
    (a, b, r0), (c, d, c0) = calibration.bundle.residual_to_confocal
    right = pattern(a * row + b * col + r0 - CONFOCAL[0], c * row + d * col + c0 - CONFOCAL[1])
    return np.where(col < SHAPE[1] / 2, confocal_share * left, calibration.bundle.residual_gain * right)


TURNED = np.deg2rad(0.3)
SIMILARITY = 1.005 * np.array([[np.cos(TURNED), -np.sin(TURNED)], [np.sin(TURNED), np.cos(TURNED)]])
PAIRS = {
    "shift": np.array([[1, 0, 4.4], [0, 1, -121.7]]),
    "turned and scaled": np.column_stack([SIMILARITY, [4.4, -122.0]]),
}


@pytest.mark.parametrize("pair", PAIRS)
@pytest.mark.parametrize("gain", [1.0, 0.93])
def test_views_that_show_the_same_cancel(pair: str, gain: float) -> None:
    calibration = calibrated(PAIRS[pair], gain)
    els = Sectioner(calibration, SHAPE).els(frame_of(calibration))
    assert np.abs(els).max() < 0.5  # of 220 grey levels


@pytest.mark.parametrize("pair", PAIRS)
def test_views_land_on_a_grid_about_the_bundle_s_centre(pair: str) -> None:
    calibration = calibrated(PAIRS[pair])
    sectioner = Sectioner(calibration, SHAPE)
    row, col = np.indices((sectioner.side,) * 2) - (sectioner.side - 1) / 2
    raw = frame_of(calibration)
    for image in (sectioner.ls(raw), sectioner.residual(raw)):
        assert np.abs(image - pattern(row, col))[sectioner.inside].max() < 0.5


def test_els_is_ls_minus_residual_to_the_bit() -> None:
    calibration = calibrated(PAIRS["turned and scaled"], 0.9)
    raw = np.random.default_rng(1).integers(0, 255, SHAPE).astype(np.uint8)
    sectioner = Sectioner(calibration, SHAPE)
    assert np.array_equal(sectioner.els(raw), sectioner.ls(raw) - sectioner.residual(raw))


def test_elsa_takes_the_residual_of_the_next_frame() -> None:
    frames = np.random.default_rng(2).integers(0, 255, (4, *SHAPE)).astype(np.uint8)
    sectioner = Sectioner(calibrated(), SHAPE)
    expected = sectioner.ls(frames[2]) - sectioner.residual(frames[3])
    confocal, residual = Mode.ELSA.source_frames(1)
    assert np.array_equal(sectioner.section(frames[confocal], frames[residual], Mode.ELSA), expected)


def test_subtraction_adds_no_bias_at_three_photons_per_pixel() -> None:
    rng = np.random.default_rng(3)
    calibration = calibrated()
    light = frame_of(calibration, confocal_share=1.5) / 120 * 3 + 4
    noisy = rng.poisson(light, (400, *SHAPE)).clip(0, 255).astype(np.uint8)
    sectioner = Sectioner(calibration, SHAPE)
    mean = np.mean([sectioner.els(frame).copy() for frame in noisy], axis=0)
    used = disc(sectioner.side, 0.9 * DIAMETER_PX)
    assert abs((mean - sectioner.els(light))[used].mean()) < 0.01
    assert np.abs(cv2.blur(mean - sectioner.els(light), (5, 5)))[used].max() < 0.3


@settings(max_examples=20, deadline=None)
@given(level=st.floats(0, 200), slope=st.floats(-0.5, 0.5))
def test_background_goes_whatever_its_shape(level: float, slope: float) -> None:
    background = (level + slope * np.arange(SHAPE[1]) + np.zeros(SHAPE)).astype(np.float32)
    calibration = calibrated(background=background)
    plain = frame_of(calibration)
    with_background = Sectioner(calibration, SHAPE).els((plain + background).astype(np.float32))
    without = Sectioner(calibrated(), SHAPE).els(plain)
    assert np.abs(with_background - without).max() < 1e-3


def test_a_bundle_cut_by_the_sensor_s_edge_is_dark_where_there_is_no_sensor() -> None:
    low = Calibration.parse(
        {
            "bundle": {
                "confocal_centre": [20.0, 58.0],
                "residual_centre": [20.0, 180.0],
                "diameter_px": DIAMETER_PX,
                "residual_to_confocal": [[1, 0, 0], [0, 1, -122]],
            }
        }
    )
    image = Sectioner(low, SHAPE).ls(np.full(SHAPE, 50, np.uint8))
    assert np.all(image[:20] == 0)
    assert image[60, 46] == pytest.approx(50, abs=1e-3)


def test_side_holds_the_disc() -> None:
    for diameter_px in (89.2, 90.0, 464.7):
        assert disc(side_px(diameter_px), diameter_px).any(axis=0)[1:-1].all()


def test_frames_of_another_region_are_refused() -> None:
    with pytest.raises(CalibrationError, match=r"120 x 240 pixels, the recording 100 x 200"):
        Sectioner(calibrated(), (100, 200))


def test_a_bundle_outside_the_frame_is_refused() -> None:
    far = Calibration.parse(
        {
            "bundle": {
                "confocal_centre": [60, 1000],
                "residual_centre": [60, 1100],
                "diameter_px": 90,
                "residual_to_confocal": [[1, 0, 0], [0, 1, -100]],
            }
        }
    )
    with pytest.raises(CalibrationError, match="outside of the 120 x 240 frame"):
        Sectioner(far, SHAPE)


def test_sectioning_gives_back_what_is_in_focus(open_recording: Path) -> None:
    truth = json.loads((open_recording / "truth.json").read_text())
    left, right = truth["left"], truth["right"]
    background = tifffile.imread(open_recording / "background.tif").mean(axis=0, dtype=np.float32)
    calibration = Calibration.parse(
        {
            "bundle": {
                "confocal_centre": left,
                "residual_centre": right,
                "diameter_px": truth["diameter_px"] + 2,
                "residual_to_confocal": [[1, 0, left[0] - right[0]], [0, 1, left[1] - right[1]]],
            }
        }
    ).model_copy(update={"background": background})
    frames = tifffile.imread(open_recording / "still.tif")
    sectioner = Sectioner(calibration, frames.shape[1:])
    in_focus = tifffile.imread(open_recording / "still_infocus.tif").squeeze().astype(np.float32)
    expected = cv2.getRectSubPix(in_focus, (sectioner.side,) * 2, (left[1], left[0]))
    used = disc(sectioner.side, 0.9 * truth["diameter_px"])

    def smooth(image: NDArray[np.float32]) -> NDArray[np.float32]:
        blurred: NDArray[np.float32] = cv2.GaussianBlur(image, (0, 0), 1.5)[used]
        return blurred

    pairs = {mode: [mode.source_frames(k) for k in range(3)] for mode in Mode}
    mean = {
        mode: np.mean([sectioner.section(frames[one], frames[other], mode) for one, other in made], axis=0)
        for mode, made in pairs.items()
    }
    correlation = {mode: np.corrcoef(smooth(image), smooth(expected))[0, 1] for mode, image in mean.items()}
    assert correlation[Mode.ELS] > 0.99
    assert correlation[Mode.LS] < 0.92
    brightness_kept = np.polyfit(smooth(expected), smooth(mean[Mode.ELS]), 1)[0]
    assert brightness_kept == pytest.approx(1, abs=0.05)


def test_a_bundle_far_larger_than_the_frame_is_refused_before_memory_is_asked_for() -> None:
    known = calibrated()
    assert known.bundle is not None
    vast = known.model_copy(update={"bundle": known.bundle.model_copy(update={"diameter_px": 1e9})})
    with pytest.raises(CalibrationError, match=r"diameter is 1e\+09 px, the frame has 120 x 240"):
        Sectioner(vast, SHAPE)


def cut_by(rows: int) -> tuple[Calibration, NDArray[np.float64], Calibration, NDArray[np.float64]]:
    """A frame of both views, and the same one without its first rows, which cut the residual view by some rows."""
    whole = calibrated()
    raw = frame_of(whole)
    assert whole.bundle is not None
    first = round(whole.bundle.residual_centre[0] - DIAMETER_PX / 2) + rows
    content = whole.content()
    content["frame"] = {"shape": (SHAPE[0] - first, SHAPE[1])}
    for key in ("confocal_centre", "residual_centre"):
        content["bundle"][key][0] -= first
    return whole, raw, Calibration.parse(content), raw[first:]


def test_residual_and_els_are_nan_where_the_frame_cuts_the_residual_view_and_ls_stays() -> None:
    whole, raw, cut, cut_raw = cut_by(3)
    expected, sectioner = Sectioner(whole, SHAPE), Sectioner(cut, cut_raw.shape)
    np.testing.assert_allclose(sectioner.ls(cut_raw), expected.ls(raw), atol=0.1)
    residual, els = sectioner.residual(cut_raw), sectioner.els(cut_raw)
    row = np.arange(sectioner.side) - (sectioner.side - 1) / 2
    beyond = np.broadcast_to(row[:, None] < 3 - DIAMETER_PX / 2 - 1, els.shape) & sectioner.inside
    assert beyond.any()
    assert np.isnan(residual[beyond]).all()
    assert np.isnan(els[beyond]).all()
    seen = np.hypot(row[:, None] - 4.4, row) < 0.95 * DIAMETER_PX / 2  # the line stands 4.4 rows aside
    np.testing.assert_allclose(els[seen], expected.els(raw)[seen], atol=0.3)
    assert not np.isnan(Sectioner(whole, SHAPE).els(raw)).any()


def test_els_is_not_ls_where_the_line_stood_outside_of_the_bundle_in_a_cut_view() -> None:
    _, _, cut, cut_raw = cut_by(2)
    offset = {"offset": {"rows": -20.0, "uncertainty_rows": 0.01}}
    els = Sectioner(Calibration.parse(cut.content() | offset), cut_raw.shape).els(cut_raw)
    row = np.arange(len(els)) - (len(els) - 1) / 2
    assert np.isnan(els[(row > -DIAMETER_PX / 2) & (row < 20 - DIAMETER_PX / 2), len(els) // 2]).all()
    assert np.isfinite(els[(row > 23 - DIAMETER_PX / 2), len(els) // 2]).all()
