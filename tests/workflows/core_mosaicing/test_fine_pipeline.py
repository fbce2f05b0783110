"""Mosaics of a bundle that is tracked on a coarser grid are drawn in pixels of the camera."""

from __future__ import annotations

from itertools import pairwise

import cv2
import numpy as np
import pytest

from napari_elsplus.instrument.calibration import Calibration
from napari_elsplus.processing.images.sectioning import Mode
from napari_elsplus.processing.tracking.front_end.grid import Grid
from napari_elsplus.viewing.mosaic.recorded import StackMosaics
from napari_elsplus.workflows.mosaic_plan import MosaicPlan
from napari_elsplus.workflows.mosaicing import MosaicResult, mosaic

DIAMETER_PX, CENTRE, OTHER = 480.0, (250.3, 249.6), (250.3, 747.6)
BUNDLE = {
    "confocal_centre": CENTRE,
    "residual_centre": OTHER,
    "diameter_px": DIAMETER_PX,
    "residual_to_confocal": [[1.0, 0.0, 0.0], [0.0, 1.0, CENTRE[1] - OTHER[1]]],
}
PLACES = np.array([(260 + 12 * k, 270 + 20 * k) for k in range(10)])
"""Scene row and column at the confocal view's pixel (0, 0)."""


def calibration() -> Calibration:
    return Calibration.parse({"bundle": BUNDLE, "optics": {"um_per_px": 1.3, "rows_per_frame": 1e5}})


def scene() -> np.ndarray:
    grain = np.random.default_rng(4).normal(size=(1100, 1100)).astype(np.float32)
    blurred = [cv2.GaussianBlur(grain, (0, 0), sigma) for sigma in (1.6, 6.0)]
    return np.asarray(np.exp(0.5 * sum(each / each.std() for each in blurred)), np.float32)


def frames(of: np.ndarray, places: np.ndarray = PLACES) -> np.ndarray:
    """Raw frames without any light in the residual view."""
    y, x = np.mgrid[:500, :1000]
    lit = np.hypot(y - CENTRE[0], x - CENTRE[1]) < DIAMETER_PX / 2
    random = np.random.default_rng(8)
    raw = np.zeros((len(places), 500, 1000), np.uint16)
    for frame, (row, col) in zip(raw, places, strict=True):
        frame[:, :500] = random.poisson(np.where(lit[:, :500], 300 * of[row : row + 500, col : col + 500], 0))
    return raw


def correlation(result: MosaicResult, of: np.ndarray, places: np.ndarray = PLACES) -> float:
    """Correlation with the scene, where the mosaic itself says that the first frame lies in it."""
    assert result.um_per_px == pytest.approx(1.3)
    top, left = places[0] + CENTRE - np.array(result.first_frame_px)
    rows, cols = np.mgrid[: result.image.shape[0], : result.image.shape[1]].astype(np.float32)
    expected = cv2.remap(of, cols + np.float32(left), rows + np.float32(top), cv2.INTER_CUBIC)
    expected = cv2.GaussianBlur(expected, (0, 0), 1.0)  # as images are smoothed
    drawn = cv2.erode((result.image != 0).astype(np.uint8), np.ones((9, 9))) == 1
    return float(np.corrcoef(result.image[drawn], expected[drawn])[0, 1])


@pytest.mark.parametrize("insertion", ["dead-leaf", "feathered"])
def test_a_large_bundle_loses_no_detail(insertion: str) -> None:
    """At half the resolution, on which it is tracked, the correlation was 0.96."""
    assert Grid.of(calibration()).binning == 2
    of = scene()
    result = mosaic(frames(of), calibration(), "els", insertion=insertion)
    assert correlation(result, of) > 0.99
    moves = [(b.row_px - a.row_px, b.col_px - a.col_px) for a, b in pairwise(result.track)]
    np.testing.assert_allclose(moves, np.diff(PLACES, axis=0), atol=0.1)


def test_a_bundle_of_few_cores_is_drawn_in_pixels_of_the_camera() -> None:
    row, col = np.mgrid[:484, :484]
    few = 1 + 0.5 * np.cos(2 * np.pi * row / 12) * np.cos(2 * np.pi * col / 12)
    lone = calibration().model_copy(update={"flat": few.astype(np.float32)})
    assert Grid.of(lone).binning > 2
    of = scene()
    assert correlation(mosaic(frames(of), lone, "els"), of) > 0.9


def test_all_image_types_and_the_growing_mosaic_have_the_same_pixels() -> None:
    of = scene()
    raw = frames(of)
    stack = StackMosaics(raw, calibration(), MosaicPlan((Mode.LS, Mode.ELS)), np.arange(len(raw)) / 60)
    stack.track()
    grown = {mode: canvases[0].extent for mode, canvases in stack.canvases.items()}
    stack.finish()
    assert stack.scale.camera_px_per_pixel == 1
    for mode, canvases in stack.canvases.items():
        finished, growing = canvases[0].extent, grown[mode]
        assert finished is not None
        assert growing is not None
        np.testing.assert_allclose(growing.shape, finished.shape, atol=30)  # the last frame was not due
    ls, els = (stack.canvases[mode][0].read()[0] for mode in (Mode.LS, Mode.ELS))
    shared = np.s_[: min(len(ls), len(els)), : min(ls.shape[1], els.shape[1])]
    both = (ls[shared] != 0) & (els[shared] != 0)
    assert np.corrcoef(ls[shared][both], els[shared][both])[0, 1] > 0.999


def test_uneven_light_is_taken_out_of_the_finer_images() -> None:
    angle = np.linspace(0, 2 * np.pi, 24)
    places = np.rint(np.stack([300 + 110 * np.sin(angle), 300 + 110 * np.cos(angle)], axis=1)).astype(int)
    of = scene()
    light = np.r_[1 + 0.3 * np.sin(np.linspace(-3, 3, 500)), np.ones(500)]
    result = mosaic((frames(of, places) * light).astype(np.uint16), calibration(), "els")
    assert any("uneven light" in note for note in result.notes)
    assert correlation(result, of, places) > 0.98
