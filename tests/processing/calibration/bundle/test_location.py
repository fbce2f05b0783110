"""The two bundle images, whatever lies before the probe and however it is lit."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest
import tifffile

from benchmarks.rigs.random_rigs import Rig
from napari_elsplus.errors import MeasurementError
from napari_elsplus.processing.calibration.bundle.location import locate_bundle, locate_pair
from napari_elsplus.processing.calibration.bundle.rim import fit_rim

if TYPE_CHECKING:
    from pathlib import Path

RIG = Rig(left=(105.0, 103.0), right=(95.5, 318.5), diameter_px=190.0)
Y, X = RIG.cores.T / RIG.diameter_px


def assert_found(image: np.ndarray, rig: Rig = RIG, within_px: float = 0.25, within: float = 0.005) -> None:
    for disc, centre, scale in zip(locate_pair(image), (rig.left, rig.right), (1.0, rig.scale), strict=True):
        assert np.hypot(*np.subtract(disc.centre, centre)) < max(within_px, 3 * disc.centre_uncertainty_px)
        assert disc.diameter_px == pytest.approx(scale * rig.diameter_px, rel=within)


def exposed(light: np.ndarray) -> np.ndarray:
    return (RIG.lit_from_far_end(light) / RIG.electrons_per_dn + 4).astype(np.uint8)


@pytest.mark.parametrize("seed", range(4))
def test_random_rigs_are_located(seed: int) -> None:
    rig = Rig.draw(100 + seed)
    assert_found(rig.bundle()[0], rig)


@pytest.mark.parametrize("photons", [5.0, 15.0])
def test_dim_bundles_are_located(photons: float) -> None:
    rig = replace(RIG, photons=photons, electrons_per_dn=1.0, read_noise_e=1.0)
    assert_found(rig.bundle()[0], rig, within_px=0.3)


def fibres() -> np.ndarray:
    random = np.random.default_rng(0)
    light = np.ones_like(X)
    for _ in range(25):
        angle, at = random.uniform(0, np.pi), random.uniform(-0.5, 0.5)
        light *= 1 - 0.75 * np.exp(-(((X * np.cos(angle) + Y * np.sin(angle) - at) / 0.02) ** 2))
    return light


@pytest.mark.parametrize(
    "light",
    [
        pytest.param(1 - 0.6 * (X + 0.5), id="uneven"),
        pytest.param(np.where(Y > 0.1, 1.0, 0.3), id="half dark"),
        pytest.param(0.1 + 0.9 * (np.sin(40 * X + 10 * Y) > 0), id="bars"),
        pytest.param(fibres(), id="tissue paper"),
    ],
)
def test_target_and_light_do_not_mislead(light: np.ndarray) -> None:
    assert_found(exposed(light), within_px=0.8)


def test_a_disc_cut_by_the_sensors_edge_keeps_its_circle() -> None:
    cut = RIG.bundle()[0][40:]
    rig = replace(RIG, left=(65.0, 103.0), right=(55.5, 318.5))
    assert_found(cut, rig, within_px=0.4, within=0.01)


def test_hot_pixels_and_stray_light_do_not_count() -> None:
    image = RIG.bundle()[0].astype(float)
    random = np.random.default_rng(1)
    image += 15 + 20 * np.linspace(0, 1, image.shape[1])
    image[random.integers(0, len(image), 150), random.integers(0, image.shape[1], 150)] = 255
    assert_found(np.clip(image, 0, 255).astype(np.uint8))


def test_sixteen_bits_and_floats_are_as_good() -> None:
    light = RIG.lit_from_far_end()
    assert_found((light * 30 + 100).astype(np.uint16))
    assert_found(light.astype(np.float32))


def test_bundles_that_nearly_touch_are_told_apart() -> None:
    rig = replace(RIG, right=(95.5, 297.0))
    assert_found(rig.bundle()[0], rig)


@pytest.mark.parametrize("columns", [(0, 400), (400, 0)])
def test_bundles_beside_the_middle_of_a_wide_frame_are_told_apart(columns: tuple[int, int]) -> None:
    rig = replace(RIG, right=(95.5, 297.0))
    image = np.pad(rig.bundle()[0], ((0, 0), columns), constant_values=4)
    moved = [(row, column + columns[0]) for row, column in (rig.left, rig.right)]
    assert_found(image, replace(rig, left=moved[0], right=moved[1]))


def refused(kind: str) -> np.ndarray:
    image = RIG.bundle()[0]
    left_only = image.copy()
    left_only[:, 210:] = 4
    return {
        "right dark": left_only,
        "left dark": np.where(np.arange(image.shape[1]) < 210, 4, image),
        "one in the middle": np.roll(left_only, 105, axis=1),
    }[kind]


@pytest.mark.parametrize("kind", ["right dark", "left dark", "one in the middle"])
def test_one_bundle_is_not_two(kind: str) -> None:
    with pytest.raises(
        MeasurementError, match=r"two bundle images expected, 1 found \(threshold [\d.]+\): is the probe"
    ):
        locate_pair(refused(kind))


@pytest.mark.parametrize(
    "image",
    [
        pytest.param(np.zeros((160, 320), np.uint8), id="black"),
        pytest.param(np.full((160, 320), 255, np.uint8), id="white"),
        pytest.param(np.random.default_rng(0).integers(0, 255, (160, 320)).astype(np.uint8), id="noise"),
        pytest.param(np.tile(np.linspace(0, 200, 320), (160, 1)), id="gradient"),
        pytest.param(np.zeros((8, 8)), id="tiny"),
    ],
)
def test_what_is_no_pair_is_refused(image: np.ndarray) -> None:
    with pytest.raises(MeasurementError):
        locate_pair(image)


@pytest.mark.parametrize(
    ("name", "diameter_px"),
    [("bundle1", 900), ("tissue_paper", 892), ("tissue_paper_back", 892), ("usaf1", 920), ("usaf1_background", 920)],
)
def test_real_bundles_are_located(data_folder: Path, name: str, diameter_px: float) -> None:
    disc = locate_bundle(tifffile.imread(data_folder / "real" / f"{name}.tif"))
    assert disc.diameter_px == pytest.approx(diameter_px, rel=0.01)


def test_structured_targets_do_not_move_real_bundles(data_folder: Path) -> None:
    for target, plain in (("tissue_paper", "tissue_paper_back"), ("usaf1", "usaf1_background")):
        with_target, without = (
            locate_bundle(tifffile.imread(data_folder / "real" / f"{name}.tif")) for name in (target, plain)
        )
        assert np.hypot(*np.subtract(with_target.centre, without.centre)) < 2


def b_scan(seed: int) -> np.ndarray:
    """An image of layered tissue with speckle, as of optical coherence tomography."""
    random = np.random.default_rng(seed)
    rows, cols = np.mgrid[:300, :500]
    depth = rows - 60 - 20 * np.sin(cols / 90 + seed) - 10 * np.sin(cols / 31)
    layers = np.where(depth > 0, np.exp(-depth / 60) * (1 + 0.4 * np.sin(depth / 9)), 0.02)
    speckle = cv2.GaussianBlur((layers * random.exponential(1, layers.shape)).astype(np.float32), (0, 0), 1.2)
    return (20 + 200 * speckle / np.percentile(speckle, 99.5)).clip(0, 255).astype(np.uint8)


@pytest.mark.parametrize("seed", range(6))
def test_layers_of_tissue_are_no_bundle(seed: int) -> None:
    with pytest.raises(MeasurementError, match="no bundle"):
        locate_bundle(b_scan(seed))


def test_a_circle_larger_than_the_frame_is_no_disc() -> None:
    """The outline of a stripe gave one of a million pixels, and its edge was sampled all along."""
    rows, cols = np.mgrid[:200, :260]
    stripe = (100 * np.exp(-(((rows - 98.6) / 2) ** 2)) * (abs(cols - 130) < 100)).astype(np.float32)
    with pytest.raises(MeasurementError, match="the lit area is no disc"):
        fit_rim(stripe, np.array([-2900.0, 130.0, 3000.0]))
