from __future__ import annotations

import numpy as np
import pytest

from napari_elsplus.errors import InputError
from napari_elsplus.simulation.specimen.trajectories import (
    PATHS,
    HandHeld,
    Raster,
    Recorded,
    Spiral,
    Straight,
    trajectory,
)

TIMES_S = np.arange(0, 4, 1e-3)


def speeds(path: object) -> np.ndarray:
    return np.hypot(*np.diff(path.positions_um(TIMES_S), axis=0).T) / 1e-3  # type: ignore[attr-defined]


@pytest.mark.parametrize("name", PATHS)
def test_every_path_starts_at_the_origin_and_has_no_jump(name: str) -> None:
    path = trajectory(name, speed_um_s=2000)
    assert path.positions_um(np.zeros(1)) == pytest.approx(np.zeros((1, 2)))
    assert speeds(path).max() < 4 * 2000


def test_strokes_run_at_their_speed() -> None:
    assert speeds(Straight(1500)) == pytest.approx(1500)
    raster = speeds(Raster(1500))
    assert raster.max() < 1.01 * 1500
    assert np.median(raster) == pytest.approx(1500)
    assert speeds(Spiral(1500)) == pytest.approx(1500, rel=0.01)


def test_raster_turns_by_its_pitch_within_its_width() -> None:
    positions = Raster(2000, width_um=1000, pitch_um=200).positions_um(TIMES_S)
    assert positions[:, 1].min() > -101
    assert positions[:, 1].max() < 1101
    assert set(np.round(positions[::1, 0][np.abs(positions[:, 1] - 500) < 5]) % 200) == {0}


def test_hand_trembles_at_its_frequency_and_wanders_at_its_speed() -> None:
    times = np.arange(0, 60, 1e-2)
    slow = HandHeld(1500, tremor_um=0).positions_um(times)
    assert np.sqrt((np.diff(slow, axis=0) ** 2).sum(1).mean()) / 1e-2 == pytest.approx(1500, rel=0.15)
    tremor = HandHeld(0.0, tremor_um=15).positions_um(times)
    assert tremor.std(0) == pytest.approx([15, 15], rel=0.15)
    power = np.abs(np.fft.rfft(tremor[:, 0] - tremor[:, 0].mean())) ** 2
    hertz = np.fft.rfftfreq(len(times), 1e-2)
    assert power[(hertz > 7.5) & (hertz < 12.5)].sum() > 0.95 * power.sum()
    assert not np.allclose(HandHeld(seed=1).positions_um(times), HandHeld(seed=2).positions_um(times))


def test_a_recorded_path_is_followed_and_not_extrapolated() -> None:
    path = Recorded(np.array([0.0, 1.0, 3.0]), np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 40.0]]))
    assert path.positions_um(np.array([0.5, 2.0])) == pytest.approx(np.array([[5.0, 0.0], [10.0, 20.0]]))
    with pytest.raises(InputError, match=r"spans 0 to 3 s, a frame needs 3.1 s"):
        path.positions_um(np.array([0.0, 3.1]))


@pytest.mark.parametrize(
    ("times", "positions", "word"),
    [
        ([0.0], [[0.0, 0.0]], "1 points"),
        ([0.0, 1.0], [[0.0, 0.0], [0.0, np.nan]], "NaN"),
        ([0.0, 2.0, 1.0], [[0.0, 0.0]] * 3, "times that do not increase"),
    ],
)
def test_what_is_no_path_is_refused(times: list[float], positions: list[list[float]], word: str) -> None:
    with pytest.raises(InputError, match=word):
        Recorded(np.array(times), np.array(positions))
