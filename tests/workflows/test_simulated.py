from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import pytest

from napari_elsplus.errors import InputError
from napari_elsplus.io import open_recording
from napari_elsplus.simulation import calibration_scenes
from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.workflows.simulated import (
    SimulatedRecording,
    simulate_axial_scan,
    simulate_calibration,
    simulate_recording,
)

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


def test_frames_come_in_any_order_and_are_those_that_are_saved(tmp_path: Path) -> None:
    simulated = simulate_recording(frames=3, seed=2)
    last = simulated[-1].copy()
    simulated.save(tmp_path / "r.ome.tif")
    with open_recording(tmp_path / "r.ome.tif") as recording:
        np.testing.assert_array_equal(recording[2], last)
        assert len(recording) == len(simulated) == 3
        assert recording.calibration is not None
        assert recording.calibration.bundle == simulated.calibration.bundle
    with pytest.raises(IndexError):
        simulated[3]
    with pytest.raises(InputError, match="exists"):
        simulated.save(tmp_path / "r.ome.tif")


def test_a_scan_has_a_frame_for_each_depth() -> None:
    scan = simulate_axial_scan(depth_um=[0, 50, 400])
    assert scan.depth_um is not None
    assert scan.depth_um.tolist() == [0, 50, 400]
    assert [int(frame.mean()) for frame in scan] == sorted((int(frame.mean()) for frame in scan), reverse=True)


@pytest.mark.parametrize(
    "simulate", [partial(simulate_axial_scan, depth_um=[0.0]), partial(simulate_recording, frames=1)]
)
def test_the_background_has_the_seed_of_the_frames_and_another_noise(
    simulate: Callable[..., SimulatedRecording],
) -> None:
    """Before: that of seed 0, of whose frames it had the noise."""
    one, again, other = (simulate(seed=seed) for seed in (0, 0, 1))
    backgrounds = [simulated.calibration.background for simulated in (one, again, other)]
    np.testing.assert_array_equal(backgrounds[0], backgrounds[1])
    assert 0.05 < np.std(backgrounds[2] - backgrounds[0]) < 1
    unlit = np.s_[:40, :40]
    assert abs(np.corrcoef(one[0][unlit].ravel(), backgrounds[0][unlit].ravel())[0, 1]) < 0.08


def test_calibration_frames_are_those_of_the_scenes() -> None:
    simulated = simulate_calibration(seed=4)
    instrument = Instrument.of("240hz", offset_um=-29.0)
    sweep = calibration_scenes.standing_line(instrument, simulated.volts, seed=5)
    np.testing.assert_array_equal(simulated.sweep[0], sweep[0])
    np.testing.assert_array_equal(simulated.bundle[0], calibration_scenes.transmission(instrument, seed=6)[0])
    np.testing.assert_array_equal(simulated.background[0], calibration_scenes.dark_tube(instrument, seed=7)[0])
    assert (len(simulated.line), len(simulated.sweep)) == (5, len(simulated.volts))


@pytest.mark.parametrize("simulate", [partial(simulate_recording, frames=0), partial(simulate_recording, frames=-1)])
def test_a_recording_without_frames_is_refused(simulate: Callable[[], SimulatedRecording]) -> None:
    """Before: a recording whose length raised an error, or of none."""
    with pytest.raises(InputError, match=r"a recording of (0|-1) frames"):
        simulate()


@pytest.mark.parametrize("depth_um", [[], [0.0, float("nan")], [0.0, float("inf")]])
def test_a_scan_of_no_depths_or_of_none_that_are_finite_is_refused(depth_um: list[float]) -> None:
    with pytest.raises(InputError, match="finite depths"):
        simulate_axial_scan(depth_um=depth_um)
