"""Image from scattered samples: what is known is found again, what is not known is not invented."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from napari_elsplus.processing.mosaicing.cores.canvas import SampleCanvas
from napari_elsplus.processing.mosaicing.cores.least_squares import Samples, choose_smoothness, reconstruct
from napari_elsplus.processing.mosaicing.cores.reconstruction import canvas_smoothness, reconstruct_canvas
from napari_elsplus.processing.mosaicing.cores.refinement import CoreGains, refine_placement

SIDE, APERTURE = 96, 1.1


def texture(seed: int = 0) -> np.ndarray:
    noise = np.random.default_rng(seed).normal(0, 1, (SIDE, SIDE)).astype(np.float32)
    return 50 + 60 * cv2.GaussianBlur(noise, (0, 0), 2.0)


def overlapping_discs(seed: int = 0) -> np.ndarray:
    """Discs of all sizes, whose power falls with the frequency as that of natural scenes."""
    random, fine = np.random.default_rng(seed), 4 * SIDE
    image = np.full((fine, fine), 50, np.float32)
    for _ in range(400):
        row, col = (int(place) for place in random.uniform(0, fine, 2))
        radius = int(min(fine, 8 * random.pareto(2) + 6))
        cv2.circle(image, (col, row), radius, float(random.uniform(20, 120)), -1)
    return cv2.resize(image, (SIDE, SIDE), interpolation=cv2.INTER_AREA)


def samples_of(image: np.ndarray, noise: float, density: float, seed: int = 1) -> Samples:
    random = np.random.default_rng(seed)
    seen = cv2.GaussianBlur(image, (0, 0), APERTURE) + random.normal(0, noise, image.shape)
    weights = (random.random(image.shape) < density).astype(np.float32)
    return Samples((seen * weights).astype(np.float32), weights)


def test_the_image_is_freed_of_the_aperture() -> None:
    true = texture()
    found = reconstruct(samples_of(true, 0.01, 0.8), APERTURE, 1e-3)
    inside = np.s_[8:-8, 8:-8]
    blurred = cv2.GaussianBlur(true, (0, 0), APERTURE)
    assert np.std((found - true)[inside]) < 0.6 * np.std((blurred - true)[inside])


@pytest.mark.parametrize("noise", [0.3, 1.0, 4.0])
def test_the_chosen_smoothness_is_near_the_best(noise: float) -> None:
    true = overlapping_discs(2)
    samples = samples_of(true, noise, 0.5)
    inside = np.s_[8:-8, 8:-8]

    def error(smoothness: float) -> float:
        return float(np.std((reconstruct(samples, APERTURE, smoothness) - true)[inside]))

    best = min(error(float(smoothness)) for smoothness in np.logspace(-4, 0, 9))
    assert error(choose_smoothness(samples, APERTURE)) < 1.15 * best


def test_a_canvas_larger_than_a_part_has_no_seams(monkeypatch: pytest.MonkeyPatch) -> None:
    random = np.random.default_rng(3)
    places = random.uniform(0, 150, (30_000, 2))
    values = (50 + 20 * np.sin(places[:, 0] / 3) * np.cos(places[:, 1] / 4)).astype(np.float32)
    canvas = SampleCanvas(2.0)
    canvas.add(places, values, np.ones(len(values), np.float32))
    smoothness = canvas_smoothness(canvas, APERTURE)
    whole = reconstruct_canvas(canvas, APERTURE, smoothness).read()[0]
    monkeypatch.setattr("napari_elsplus.processing.mosaicing.cores.reconstruction.PART", 64)
    parts = reconstruct_canvas(canvas, APERTURE, smoothness).read()[0]
    assert np.abs(whole - parts)[5:-5, 5:-5].max() < 0.1 * values.std()


def test_place_exposure_and_gains_of_a_frame_are_found() -> None:
    expected = cv2.GaussianBlur(texture(4), (0, 0), APERTURE)
    random = np.random.default_rng(5)
    places = random.uniform(10, SIDE - 10, (2000, 2))
    moved = np.add(places, (0.6, -0.9)).astype(np.float32)
    values = 1.07 * cv2.remap(expected, moved[:, 1], moved[:, 0], cv2.INTER_LINEAR).ravel()
    found = refine_placement(expected, places, values, np.ones(2000, np.float32), 4.0)
    assert found == pytest.approx((0.6, -0.9, 1.07), abs=0.02)
    gains = CoreGains(2000)
    dim = np.where(np.arange(2000) % 2, 0.8, 1.0).astype(np.float32)
    for _ in range(20):
        gains.add(expected, places + found[:2], values * dim, found.exposure)
    ratio = gains.corrections(20)[1::2].mean() / gains.corrections(20)[::2].mean()
    assert ratio == pytest.approx(1 / 0.8, rel=0.03)


def test_a_frame_that_fits_nowhere_stays() -> None:
    expected = texture(6)
    places = np.random.default_rng(7).uniform(10, SIDE - 10, (500, 2))
    values = np.random.default_rng(8).normal(50, 20, 500).astype(np.float32)
    found = refine_placement(expected, places, values, np.ones(500, np.float32), 0.05)
    assert np.hypot(found.row, found.col) <= 0.05
