from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree
from skimage.feature import peak_local_max

from napari_elsplus.errors import MeasurementError
from napari_elsplus.processing.images.cores import CoreFilter, _peaks, core_pitch_px, core_spacing_px, find_cores
from napari_elsplus.processing.images.sectioning import disc

SIDE = 201
INSIDE = disc(SIDE, 190)


def lattice(pitch_px: float, seed: int = 0) -> NDArray[np.float64]:
    """Centres of a jittered hexagonal lattice that covers the disc."""
    rng = np.random.default_rng(seed)
    k = np.arange(-SIDE, SIDE)
    a, b = np.meshgrid(k, k)
    row = pitch_px * np.sqrt(3) / 2 * b + (SIDE - 1) / 2
    col = pitch_px * (a + 0.5 * b) + (SIDE - 1) / 2
    cores = np.column_stack([row.ravel(), col.ravel()]) + rng.normal(0, 0.05 * pitch_px, (row.size, 2))
    return cores[np.hypot(*(cores - (SIDE - 1) / 2).T) < 94]


def honeycomb(cores: NDArray[np.float64], light: NDArray[np.float64], pitch_px: float) -> NDArray[np.float32]:
    """Each core a Gaussian spot of its light, on a grid four times as fine."""
    fine = np.zeros((4 * SIDE, 4 * SIDE))
    row, col = np.round(4 * cores + 1.5).astype(int).T
    np.add.at(fine, (row, col), light)
    spots = gaussian_filter(fine, 4 * 0.28 * pitch_px)
    return spots.reshape(SIDE, 4, SIDE, 4).mean(axis=(1, 3)).astype(np.float32) * np.float32(16 * pitch_px**2)


def scene_at(row: NDArray[np.float64], col: NDArray[np.float64]) -> NDArray[np.float64]:
    return 60 + 30 * np.sin(row / 9) * np.cos(col / 12)


@pytest.mark.parametrize("pitch_px", [2.4, 3.33, 5.2, 6.8])
def test_pitch_is_read_off_the_honeycomb(pitch_px: float) -> None:
    cores = lattice(pitch_px)
    flat = honeycomb(cores, np.ones(len(cores)), pitch_px)
    assert core_pitch_px(flat, INSIDE) == pytest.approx(pitch_px, rel=0.02)


@pytest.mark.parametrize("pitch_px", [3.33, 5.2, 6.8])
def test_spacing_is_that_of_local_maxima(pitch_px: float) -> None:
    cores = lattice(pitch_px)
    assert core_spacing_px(honeycomb(cores, np.ones(len(cores)), pitch_px), INSIDE) == pytest.approx(pitch_px, rel=0.1)


def test_smooth_light_shows_no_cores() -> None:
    noise = gaussian_filter(np.random.default_rng(0).normal(0, 10, (SIDE, SIDE)), 2)
    vignette = 100 - 0.005 * np.square(np.arange(SIDE) - SIDE / 2)
    assert core_spacing_px(vignette + noise, INSIDE) is None


@pytest.mark.parametrize("pitch_px", [3.33, 5.2])
def test_cores_are_found_where_they_are(pitch_px: float) -> None:
    cores = lattice(pitch_px)
    transmission = 1 + 0.15 * np.random.default_rng(1).standard_normal(len(cores))
    found = find_cores(honeycomb(cores, transmission, pitch_px), INSIDE)
    distance, _ = cKDTree(found).query(cores)
    assert np.mean(distance < 0.3 * pitch_px) > 0.98
    assert len(found) == pytest.approx(len(cores), rel=0.03)


def test_an_image_without_cores_is_refused() -> None:
    smooth = gaussian_filter(np.random.default_rng(0).normal(100, 5, (SIDE, SIDE)), 4).astype(np.float32)
    with pytest.raises(MeasurementError, match="no core pattern"):
        find_cores(smooth, INSIDE)


@pytest.mark.parametrize("pitch_px", [2.4, 3.33, 5.2])
def test_filters_keep_the_scene_and_drop_the_cores(pitch_px: float) -> None:
    cores = lattice(pitch_px)
    rng = np.random.default_rng(2)
    transmission = 1 + 0.15 * rng.standard_normal(len(cores))
    flat = honeycomb(cores, transmission, pitch_px)
    image = honeycomb(cores, transmission * scene_at(*cores.T), pitch_px)
    row, col = np.indices((SIDE, SIDE)).astype(float)
    mean_of_flat = gaussian_filter(flat, 3 * pitch_px) / (gaussian_filter(INSIDE.astype(float), 3 * pitch_px) + 1e-9)
    expected = scene_at(row, col) * mean_of_flat
    used = disc(SIDE, 160)
    error = {
        kind: np.std((kind.prepared(flat, INSIDE)(image) - expected)[used]) / expected[used].mean()
        for kind in CoreFilter
    }
    assert error[CoreFilter.INTERPOLATE] < 0.05
    assert error[CoreFilter.INTERPOLATE] < 0.5 * error[CoreFilter.GAUSSIAN]
    assert error[CoreFilter.GAUSSIAN] < error[CoreFilter.NONE]
    brightness = CoreFilter.INTERPOLATE.prepared(flat, INSIDE)(image)[used].mean() / expected[used].mean()
    assert brightness == pytest.approx(1, abs=0.02)


@pytest.mark.parametrize("kind", [CoreFilter.GAUSSIAN, CoreFilter.INTERPOLATE])
def test_a_filter_that_needs_a_flat_field_says_so(kind: CoreFilter) -> None:
    with pytest.raises(MeasurementError, match="needs a flat field"):
        kind.prepared(None, INSIDE)


@pytest.mark.parametrize("kind", CoreFilter)
def test_filters_leave_their_input_alone(kind: CoreFilter) -> None:
    cores = lattice(3.33)
    flat = honeycomb(cores, np.ones(len(cores)), 3.33)
    image = flat.copy()
    kind.prepared(flat, INSIDE)(image)
    assert np.array_equal(image, flat)


def test_pitch_of_a_real_bundle(data_folder: Path) -> None:
    crop = tifffile.imread(data_folder / "real" / "bundle1.tif")[280:680, 430:830].astype(np.float32)
    assert core_pitch_px(crop, np.ones(crop.shape, bool)) == pytest.approx(5.2, rel=0.03)


def test_a_bundle_of_more_cores_than_opencv_maps_at_once_is_read() -> None:
    side = 700
    pitch_px = 3.3
    row, col = np.mgrid[0:side, 0:side]
    lattice_px = 2 * np.pi / (pitch_px * np.sqrt(3) / 2)
    waves = [np.cos(lattice_px * (row * np.sin(a) + col * np.cos(a))) for a in np.radians([0, 60, 120])]
    flat = (1 + 0.3 * sum(waves)).astype(np.float32)
    inside = disc(side, 690)
    scene = (10 + row / 10 + col / 20).astype(np.float32)
    assert len(find_cores(flat, inside)) > 32_767
    filtered = CoreFilter.INTERPOLATE.prepared(flat, inside)(flat * scene)
    middle = disc(side, 600)
    assert np.abs(filtered / scene - 1)[middle].mean() < 0.02


@pytest.mark.parametrize("reach", [2, 3, 5])
def test_peaks_are_those_of_scikit_image(reach: int) -> None:
    image = np.random.default_rng(reach).integers(0, 300, (120, 140)).astype(np.float32)  # with equal neighbours
    expected = peak_local_max(image, min_distance=reach, threshold_abs=150.0)
    np.testing.assert_array_equal(_peaks(image, reach, 150.0), expected)
