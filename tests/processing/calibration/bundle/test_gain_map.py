"""Gain of the residual view over the field: mapped where the cores or a vignette need it, and nowhere else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from benchmarks.rigs.random_rigs import Rig
from napari_elsplus.errors import CalibrationError
from napari_elsplus.instrument.calibration import Calibration
from napari_elsplus.io import read_calibration, write_calibration
from napari_elsplus.processing.calibration.draft import Draft
from napari_elsplus.processing.calibration.measurements import measure_pair
from napari_elsplus.processing.calibration.sections import apply_pair
from napari_elsplus.processing.images.sectioning import Sectioner, disc
from napari_elsplus.simulation.calibration_scenes import transmission
from napari_elsplus.simulation.model.imperfections import Imperfections
from napari_elsplus.simulation.model.instrument import Instrument

RIG = Rig(left=(105.0, 103.0), right=(95.5, 318.3), diameter_px=190.0, turn_deg=0.2, photons=600.0)


def uneven_gain(core_sd: float, vignette: float) -> np.ndarray:
    """Mean frame in transmission whose right view has gains by cores, and more light in its middle."""
    mean = RIG.lit_from_far_end()
    rows, cols = np.indices(mean.shape)
    away = np.stack([rows - RIG.right[0], cols - RIG.right[1]], axis=-1) @ np.linalg.inv(RIG.left_to_right).T
    gains = np.random.default_rng(9).normal(1, core_sd, len(RIG.cores))
    nearest = cKDTree(RIG.cores).query(away.reshape(-1, 2))[1].reshape(mean.shape)
    radius = np.hypot(*np.moveaxis(away, -1, 0)) / (RIG.diameter_px / 2)
    gain = gains[nearest] * (1 + vignette * (1 - 2 * np.minimum(radius, 1) ** 2))
    return np.where(cols > (RIG.left[1] + RIG.right[1]) / 2, mean * gain, mean)


def calibrated(core_sd: float, vignette: float) -> Calibration:
    frames = RIG._noisy(np.repeat(uneven_gain(core_sd, vignette)[None], 3, axis=0), 3)
    return apply_pair(Draft(Calibration()), measure_pair(frames))


def remainder(calibration: Calibration, core_sd: float, vignette: float) -> float:
    """Alignment error in another frame, with noise of its own."""
    frame = RIG._noisy(uneven_gain(core_sd, vignette)[None], 77)[0] - np.float32(RIG.black_dn)
    sectioner = Sectioner(calibration.model_copy(update={"background": None}), frame.shape)
    ls, residual = sectioner.ls(frame), sectioner.residual(frame)
    seen = sectioner.inside & np.isfinite(residual)
    return float(np.abs(ls - residual)[seen].mean() / ls[seen].mean())


@pytest.mark.parametrize(("core_sd", "vignette"), [(0.1, 0.0), (0.0, 0.1), (0.1, 0.1)])
def test_gains_of_cores_and_a_vignette_are_mapped(core_sd: float, vignette: float) -> None:
    clean = remainder(calibrated(0.0, 0.0), 0.0, 0.0)
    found = calibrated(core_sd, vignette)
    assert found.gain_map is not None
    assert found.content()["version"] == 2
    assert remainder(found, core_sd, vignette) < 1.3 * clean
    single = found.with_view_arrays(found.distortion, None)
    assert remainder(found, core_sd, vignette) < 0.8 * remainder(single, core_sd, vignette)


def test_a_vignette_is_mapped_where_the_sampling_of_the_cores_hides_it() -> None:
    """A vignette of 5 % left a single gain where a pixel sees parts of several cores: the middle was 4 % too bright."""
    instrument = replace(Instrument.of("240hz"), imperfections=Imperfections(right_vignette_percent=5.0))
    found = apply_pair(Draft(Calibration()), measure_pair(list(transmission(instrument))[:4]))
    assert found.gain_map is not None
    assert found.gain_map[tuple(np.array(found.gain_map.shape) // 2)] == pytest.approx(1.04, abs=0.01)


@pytest.mark.parametrize("vignette", [0.1, -0.1])
def test_single_gain_and_map_together_are_the_gain(vignette: float) -> None:
    """The map was divided by its mean over the whole disc, the gain measured in nine tenths of it: 2 % too much."""
    frame = RIG._noisy(uneven_gain(0.0, vignette)[None], 78)[0] - np.float32(RIG.black_dn)
    sectioner = Sectioner(calibrated(0.0, vignette).model_copy(update={"background": None}), frame.shape)
    middle = disc(sectioner.side, 0.8 * RIG.diameter_px)
    ls, residual = (float(image[middle].sum()) for image in (sectioner.ls(frame), sectioner.residual(frame)))
    assert residual / ls == pytest.approx(1, abs=0.003)


@pytest.mark.parametrize("vignette", [0.03, 0.05, -0.05])
def test_a_vignette_is_mapped_as_exactly_in_the_middle_as_at_the_rim(vignette: float) -> None:
    """A map smoothed over a sixteenth of the diameter was a twentieth of the vignette too weak."""
    found = calibrated(0.0, vignette)
    assert found.gain_map is not None
    frame = uneven_gain(0.0, vignette)
    sectioner = Sectioner(found.model_copy(update={"background": None}), frame.shape)
    ls, residual = sectioner.ls(frame), sectioner.residual(frame)
    middle, whole = (disc(sectioner.side, share * RIG.diameter_px) & np.isfinite(residual) for share in (0.4, 0.9))
    gains = [float(residual[part].sum() / ls[part].sum()) for part in (middle, whole)]
    assert gains[0] == pytest.approx(gains[1], rel=1e-3)


def test_a_single_gain_is_kept_where_it_is_sufficient() -> None:
    found = calibrated(0.0, 0.0)
    assert found.gain_map is None
    assert found.content()["version"] == 1


@pytest.mark.parametrize("on_camera_grid", [False, True])
def test_els_with_a_gain_map_is_exactly_ls_minus_residual(on_camera_grid: bool) -> None:
    frame = RIG.bundle()[0]
    sectioner = Sectioner(calibrated(0.1, 0.1), frame.shape, on_camera_grid=on_camera_grid)
    np.testing.assert_array_equal(sectioner.els(frame), sectioner.ls(frame) - sectioner.residual(frame))


def test_a_file_with_a_gain_map_is_not_read_without_it(tmp_path) -> None:
    found = calibrated(0.0, 0.1)
    write_calibration(tmp_path / "c.json", found)
    again = read_calibration(tmp_path / "c.json")
    assert again == found
    np.savez(tmp_path / "c.npz", flat=found.flat)
    with pytest.raises(CalibrationError, match=r"needs the gain map in c\.npz"):
        read_calibration(tmp_path / "c.json")
    with pytest.raises(CalibrationError, match="gain map is absent"):
        Sectioner(again.model_copy(update={"gain_map": None}), RIG.shape)
