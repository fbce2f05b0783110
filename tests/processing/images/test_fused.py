"""The fused kernel against the resampling of each view by itself, and against interpolation in double precision."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from napari_elsplus.processing.images.fused import MAX_SLOPE, MAX_STRETCH, FusedSections
from napari_elsplus.processing.images.resampling import LOBES, affine_positions, resampled, taps
from napari_elsplus.processing.images.sectioning import disc, side_px

SHAPE = (150, 330)
DIAMETER_PX = 120.0
SIDE = side_px(DIAMETER_PX)
INSIDE = disc(SIDE, DIAMETER_PX + 2)
GAIN = 0.93
BACKGROUND = np.random.default_rng(1).uniform(3, 9, SHAPE).astype(np.float32)
CONFOCAL = np.array([[1, 0, 13.3], [0, 1, 17.6]])
SHIFTS = {"fractions of pixels": CONFOCAL, "whole pixels": np.rint(CONFOCAL)}


def turned(degrees: float, scale: float) -> NDArray[np.float64]:
    """Map of the grid to a residual view of this rotation and scale, about the middle of the grid."""
    angle, middle = np.deg2rad(degrees), (SIDE - 1) / 2
    linear = scale * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return np.column_stack([linear, np.subtract((75.2, 240.7), linear @ (middle, middle))])


MAPS = {
    "shift": turned(0, 1),
    "simulated": turned(0.15, 1.001),
    "turned": turned(-0.8, 0.9999),
    "smaller": turned(0.1, 0.986),
    "larger": turned(-0.3, 1.015),
}


def band_limited() -> NDArray[np.uint8]:
    """A raw frame with structure up to 0.35 cycles per pixel."""
    spectrum = np.fft.rfft2(np.random.default_rng(2).normal(size=SHAPE))
    spectrum[np.hypot(np.fft.fftfreq(SHAPE[0])[:, None], np.fft.rfftfreq(SHAPE[1])) > 0.35] = 0
    noise = np.fft.irfft2(spectrum, SHAPE)
    return (100 + 30 * noise / noise.std()).clip(0, 255).astype(np.uint8)


def separately(raw: NDArray[np.uint8], grid_to_frame: NDArray[np.float64], gain: float) -> NDArray[np.float32]:
    """Resample one view by itself."""
    return resampled(raw - BACKGROUND, affine_positions(grid_to_frame, SIDE)) * INSIDE / np.float32(gain)


def exactly(raw: NDArray[np.uint8], grid_to_frame: NDArray[np.float64], gain: float) -> NDArray[np.float64]:
    """Interpolate one view with weights of its own for every pixel, across at whole rows and then down."""
    (a, b, r0), (c, d, c0) = grid_to_frame
    image = (raw - BACKGROUND).astype(float)
    grid = np.arange(SIDE)
    out = np.zeros((SIDE, SIDE))
    for col in grid:
        frame_rows = np.arange(SHAPE[0])
        at = c0 + c * (frame_rows - r0 - b * col) / a + d * col
        first = np.floor(at).astype(int)
        pixels = np.clip(first[:, None] + np.arange(1 - LOBES, LOBES + 1), 0, SHAPE[1] - 1)
        across = (image[frame_rows[:, None], pixels] * taps(at - first)).sum(axis=1)
        at = r0 + a * grid + b * col
        first = np.floor(at).astype(int)
        rows = np.clip(first[:, None] + np.arange(1 - LOBES, LOBES + 1), 0, SHAPE[0] - 1)
        out[:, col] = (across[rows] * taps(at - first)).sum(axis=1)
    return out * INSIDE / gain


def images(
    raw: NDArray[np.generic], confocal: NDArray[np.float64], residual: NDArray[np.float64]
) -> list[NDArray[np.float32]]:
    made = [np.full((SIDE, SIDE), np.nan, np.float32) for _ in range(3)]
    FusedSections(confocal, residual, GAIN, INSIDE, BACKGROUND, SHAPE)(raw, raw, *made)
    return made


@pytest.mark.parametrize("shift", SHIFTS)
@pytest.mark.parametrize("view", MAPS)
def test_images_are_those_of_the_views_resampled_separately(view: str, shift: str) -> None:
    raw = band_limited()
    ls, residual, els = images(raw, SHIFTS[shift], MAPS[view])
    expected_ls, expected = separately(raw, SHIFTS[shift], 1), separately(raw, MAPS[view], GAIN)
    contrast = expected[INSIDE].std()
    assert np.sqrt(np.mean((ls - expected_ls)[INSIDE] ** 2)) < 0.003 * contrast
    assert np.sqrt(np.mean((residual - expected)[INSIDE] ** 2)) < 0.01 * contrast
    np.testing.assert_array_equal(els, ls - residual)
    assert not np.any(np.stack([ls, residual, els])[:, ~INSIDE])


@pytest.mark.parametrize("view", MAPS)
def test_sharing_of_weights_leaves_no_more_than_half_a_percent(view: str) -> None:
    raw = band_limited()
    _, residual, _ = images(raw, CONFOCAL, MAPS[view])
    expected = exactly(raw, MAPS[view], GAIN)
    assert np.sqrt(np.mean((residual - expected)[INSIDE] ** 2)) < 0.005 * expected[INSIDE].std()


def test_frames_of_8_bit_and_of_float_give_the_same() -> None:
    raw = band_limited()
    for eight, floating in zip(
        images(raw, CONFOCAL, MAPS["turned"]), images(raw.astype(float), CONFOCAL, MAPS["turned"]), strict=True
    ):
        np.testing.assert_array_equal(eight, floating)


def test_only_the_images_that_are_given_are_made() -> None:
    raw = band_limited()
    expected = images(raw, CONFOCAL, MAPS["simulated"])
    fused = FusedSections(CONFOCAL, MAPS["simulated"], GAIN, INSIDE, BACKGROUND, SHAPE)
    for wanted in range(3):
        given: list[NDArray[np.float32] | None] = [None, None, None]
        given[wanted] = image = np.empty((SIDE, SIDE), np.float32)
        fused(raw, raw, *given)
        np.testing.assert_array_equal(image, expected[wanted])


def test_images_may_be_parts_of_others() -> None:
    raw = band_limited()
    whole = np.zeros((SIDE, 2 * SIDE), np.float32)
    FusedSections(CONFOCAL, MAPS["shift"], GAIN, INSIDE, BACKGROUND, SHAPE)(raw, raw, None, None, whole[:, ::2])
    np.testing.assert_array_equal(whole[:, ::2], images(raw, CONFOCAL, MAPS["shift"])[2])
    assert not whole[:, 1::2].any()


def test_beyond_the_frame_its_edge_is_repeated() -> None:
    corner = np.array([[1, 0, 0.4], [0, 1, 0.3]])
    raw = np.full(SHAPE, 80, np.uint8)
    made = [np.empty((SIDE, SIDE), np.float32) for _ in range(2)]
    FusedSections(corner, corner, 1.0, INSIDE, np.full(SHAPE, 5, np.float32), SHAPE)(raw, raw, *made, None)
    for image in made:
        np.testing.assert_allclose(image[INSIDE], 75, atol=1e-3)


def test_rotation_and_scale_have_limits() -> None:
    for degrees, scale in ((0.8, 1), (0, 1 + 0.9 * MAX_STRETCH)):
        assert FusedSections.fits(turned(degrees, scale), SIDE)
    for degrees, scale in ((1.1 * np.rad2deg(MAX_SLOPE), 1), (0, 1 + 1.1 * MAX_STRETCH), (0, 1 - 1.1 * MAX_STRETCH)):
        assert not FusedSections.fits(turned(degrees, scale), SIDE)
    assert not FusedSections.fits(turned(0, 1), 2000)
