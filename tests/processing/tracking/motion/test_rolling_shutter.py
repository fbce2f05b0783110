from __future__ import annotations

import math

import numpy as np
import pytest

from napari_elsplus.errors import InputError
from napari_elsplus.instrument.calibration import Calibration
from napari_elsplus.processing.tracking.front_end.grid import Grid
from napari_elsplus.processing.tracking.motion.rolling_shutter import Displacement, RollingShutter, Velocity, Warp

SHUTTER = RollingShutter(300.0)
BEFORE, AFTER = Velocity(30.0, -12.0), Velocity(34.0, -7.0)


def test_warp_is_where_a_point_of_the_scene_lies_in_both_frames() -> None:
    """Brute force: follow one point through both frames' rows."""
    step = SHUTTER.step(BEFORE, AFTER)
    warp = SHUTTER.warp(BEFORE, AFTER, step)
    for y, x in ((-90.0, 20.0), (0.0, 0.0), (75.0, -60.0)):
        scene = y + BEFORE.row * y / 300, x + BEFORE.col * y / 300
        later = warp.a * y + warp.b, x + warp.s * y + warp.d
        seen = (
            later[0] + AFTER.row * later[0] / 300 + step.row,
            later[1] + AFTER.col * later[0] / 300 + step.col,
        )
        assert seen == pytest.approx(scene, abs=1e-9)


def test_both_velocities_come_back_from_the_four_parameters() -> None:
    warp = SHUTTER.warp(BEFORE, AFTER, SHUTTER.step(BEFORE, AFTER))
    found = SHUTTER.velocities(warp)
    np.testing.assert_allclose(found, (BEFORE, AFTER), atol=1e-9)
    np.testing.assert_allclose(SHUTTER.displacement(warp, AFTER), SHUTTER.step(BEFORE, AFTER), atol=1e-9)


@pytest.mark.parametrize("periods_per_readout", [1.05, 2.0, 4.0, 24.0])
def test_displacement_of_a_smooth_motion_is_the_mean_of_the_velocities_at_every_frame_rate(
    periods_per_readout: float,
) -> None:
    """A probe that accelerates steadily while 280 rows are read, the camera idle in between."""
    rows = 280.0 * periods_per_readout
    bundle = {"confocal_centre": [140.0, 150.0], "residual_centre": [140.0, 450.0], "diameter_px": 280.0,
              "residual_to_confocal": [[1, 0, 0], [0, 1, -300]]}  # fmt: skip
    shutter = Grid.of(Calibration.parse({"bundle": bundle, "optics": {"rows_per_frame": rows}})).shutter
    speed, gain = np.array([12.0, -7.0]), np.array([3.0, 2.0])  # pixels per frame period, and per period squared

    def place(period: float | np.ndarray) -> np.ndarray:
        return np.multiply.outer(period, speed) + 0.5 * np.multiply.outer(np.square(period), gain)

    read = np.linspace(-140, 140, 281) / rows
    before, after = (Velocity(*np.polyfit(read, place(k + read), 1)[0]) for k in (0, 1))
    moved = place(1.0) - place(0.0)
    np.testing.assert_allclose(shutter.step(before, after), moved, atol=1e-9)
    found = shutter.velocities(shutter.warp(before, after, Displacement(*moved)))
    np.testing.assert_allclose(found, (before, after), atol=1e-6)


@pytest.mark.parametrize("shutter", [SHUTTER, RollingShutter(math.inf)], ids=["rolling", "global"])
def test_velocities_of_frames_further_apart_are_those_per_frame_period(shutter: RollingShutter) -> None:
    after = AFTER if math.isfinite(shutter.line_periods_per_frame) else BEFORE  # the warp then tells their mean alone
    moved = Displacement(*(4 * np.array(shutter.step(BEFORE, after))))
    found = shutter.velocities(shutter.warp(BEFORE, after, moved), periods=4)
    np.testing.assert_allclose(found, (BEFORE, after), atol=1e-9)


def test_without_a_rolling_shutter_the_displacement_is_minus_the_shift() -> None:
    still = RollingShutter(math.inf)
    warp = Warp(1.0, -8.0, 0.0, 3.0)
    assert still.displacement(warp, AFTER) == (8.0, -3.0)
    assert still.velocities(warp)[1] == (8.0, -3.0)


def test_impossible_timing_is_refused() -> None:
    with pytest.raises(InputError, match=r"line_periods_per_frame is 0\.0"):
        RollingShutter(0.0)
