"""Light of the line is estimated from overlapping frames of moving tissue, and even light is left as it is."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from napari_elsplus.processing.mosaicing.line_light import LineLight, estimate_line_light
from napari_elsplus.processing.tracking.front_end.grid import Grid
from napari_elsplus.processing.tracking.motion.pose import Pose, TrackingState
from napari_elsplus.processing.tracking.motion.rolling_shutter import RollingShutter, Velocity

SIDE = 120
GRID = Grid(SIDE, 1, (0, 0), ((SIDE - 1) / 2,) * 2, 116.0, RollingShutter(np.inf))
LIGHT = 1 + 0.15 * np.sin(np.linspace(-2, 4, SIDE))
SCAN = np.linspace(0.6, 1.4, SIDE)[:, None]


def scanned(
    light: np.ndarray,
    seed: int = 0,
    haze: float = 0.0,
    flicker: float = 0.02,
    across: float = 1.0,
    down: float = 1.0,
    turns: float = 1.0,
    fall: float = 0.0,
    breath: float = 0.0,
) -> LineLight | None:
    """Estimate the light from 60 frames on a loop, with shares of its motion along and across the line.

    A number of turns below 1 leaves the loop open; the light falls by a share in the course of the frames, and their
    contrast comes and goes by a share, as where the focus does.
    """
    random = np.random.default_rng(seed)
    grain = random.normal(size=(420, 420)).astype(np.float32)
    scene = np.exp(1.2 * cv2.GaussianBlur(grain, (0, 0), 2.5) / 0.11)
    angle = np.linspace(0, 2 * np.pi * turns, 60)
    power = (1 - fall) ** np.linspace(0, 1, 60) * (1 - breath * (0.5 - 0.5 * np.cos(np.linspace(0, 5 * np.pi, 60))))
    places = np.rint(np.stack([down * 70 * np.sin(angle), across * 70 * np.cos(angle)], axis=1)).astype(int)
    static = haze * np.linspace(0, 1, SIDE)
    images, poses = [], []
    for (down_px, across_px), bright in zip(places, power, strict=True):
        seen = scene[150 + down_px :, 150 + across_px :][:SIDE, :SIDE] * light * bright * random.normal(1, flicker)
        images.append((seen + static + random.normal(0, 0.05, seen.shape)).astype(np.float32))
        poses.append(Pose(0, float(down_px), float(across_px), Velocity(0.0, 0.0), 1.0, 0.01, TrackingState.TRACKED))
    return estimate_line_light(lambda index: images[index], poses, GRID)


def misfit(found: LineLight, light: np.ndarray) -> float:
    """Standard deviation of the estimated light over the true one, in the field, relative."""
    y, x = np.mgrid[:SIDE, :SIDE] - (SIDE - 1) / 2
    ratio = (found.relative / light)[np.hypot(y, x) < 0.42 * SIDE]
    return float(ratio.std() / ratio.mean())


@pytest.mark.parametrize("haze", [0.0, 1.0])
def test_uneven_light_is_found_whatever_haze_stands_still(haze: float) -> None:
    found = scanned(LIGHT, haze=haze)
    assert found is not None
    assert found.uneven
    assert misfit(found, LIGHT) < 0.02


@pytest.mark.parametrize("light", [SCAN, SCAN * LIGHT])
def test_light_that_falls_over_the_scan_is_found_with_and_without_that_along_the_line(light: np.ndarray) -> None:
    found = scanned(np.broadcast_to(light, (SIDE, SIDE)), haze=1.0)
    assert found is not None
    assert found.uneven
    assert misfit(found, light) < 0.03


def test_a_factor_that_is_even_is_not_modelled() -> None:
    found = scanned(LIGHT)
    assert found is not None
    middle = found.relative[:, SIDE // 2]
    np.testing.assert_allclose(middle[8:-8], middle[SIDE // 2], rtol=1e-6)


@pytest.mark.parametrize("seed", range(4))
def test_even_light_is_left_as_it_is(seed: int) -> None:
    found = scanned(np.ones(SIDE), seed, haze=0.5)
    assert found is not None
    assert not found.uneven
    assert found.departure < 4 * found.uncertainty + 0.01


@pytest.mark.parametrize("across", [0.05, 0.0])
def test_motion_across_the_line_alone_gives_no_evidence_of_the_light_along_it(across: float) -> None:
    """Ratios that are off alike by 2 % made a ramp of 60 % of moves by a fifteenth of the field."""
    found = scanned(LIGHT, across=across)
    assert found is not None
    assert not found.uneven
    assert np.ptp(found.relative[SIDE // 2, 8:-8]) < 1e-6


def test_a_probe_that_hardly_moves_gives_no_evidence() -> None:
    assert scanned(LIGHT, across=0.05, down=0.05) is None


@pytest.mark.parametrize("fall", [0.3, 0.8])
@pytest.mark.parametrize("seed", range(3))
def test_light_that_fades_on_the_way_is_not_uneven(seed: int, fall: float) -> None:
    """The light was stated to be 42 to 192 % of its mean where it was 85 to 115 %, and the mosaic divided by it."""
    found = scanned(np.ones(SIDE), seed, turns=0.5, fall=fall)
    assert found is not None
    assert not found.uneven
    assert misfit(found, np.ones(SIDE)) < 0.02


@pytest.mark.parametrize("seed", range(3))
def test_contrast_that_comes_and_goes_with_the_focus_is_not_uneven_light(seed: int) -> None:
    """The light was stated to be 28 to 231 % of its mean, and the mosaic divided by it."""
    found = scanned(np.ones(SIDE), seed, turns=0.5, breath=0.6)
    assert found is not None
    assert not found.uneven


@pytest.mark.parametrize("fall", [0.0, 0.3, 0.8])
def test_uneven_light_is_found_on_an_open_path_whether_or_not_it_fades(fall: float) -> None:
    ramp = LIGHT * np.linspace(0.8, 1.2, SIDE)
    found = scanned(ramp, turns=0.5, fall=fall)
    assert found is not None
    assert found.uneven
    assert misfit(found, ramp) < 0.02
