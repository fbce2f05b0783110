from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from napari_elsplus.errors import InputError
from napari_elsplus.processing.images.sectioning import Sectioner
from napari_elsplus.simulation import calibration_scenes
from napari_elsplus.simulation.model.bundle import Bundle
from napari_elsplus.simulation.model.instrument import Instrument, ResidualView
from napari_elsplus.simulation.rendering.renderer import Renderer
from napari_elsplus.simulation.specimen.scenes import distal_light, scene
from napari_elsplus.simulation.specimen.trajectories import Straight
from napari_elsplus.simulation.truth import motion, true_calibration


def test_slits_and_offsets_of_the_paper_are_rows() -> None:
    assert [Instrument.of("120hz", slit_um=um).slit_rows for um in (1.9, 2.9, 5.8, 8.8)] == [2, 3, 6, 9]
    assert Instrument.of("120hz", offset_um=-29).offset_rows == pytest.approx(-30.18, abs=0.01)


@pytest.mark.parametrize("preset", ["120hz", "240hz"])
def test_mirror_does_not_know_the_objective(preset: str) -> None:
    """The voltage for the sensor's middle row is the paper's in either preset."""
    instrument = Instrument.of(preset)
    row = 524 - instrument.preset.sensor_origin[0]
    assert instrument.volts_at_row_zero + instrument.volts_per_row * row == pytest.approx(-0.459 + 0.00126 * 524)


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"light_dn": 0.0}, "light_dn is 0.0"),
        ({"slit_rows": -1.0}, "slit_rows is -1.0"),
        ({"slit_rows": 700.0}, "slit is 672.6 um wide, the bundle 620.0 um"),
        ({"offset_rows": 800.0}, "beyond the bundle"),
        ({"offset_rows": 500.0}, "do not fit a frame of 1048 x 1328"),
        ({"read_noise_e": float("nan")}, "read_noise_e is nan"),
        ({"volts_per_row": 0.0}, "volts_per_row is 0"),
    ],
)
def test_impossible_optics_are_refused_with_their_value(changes: dict[str, Any], word: str) -> None:
    with pytest.raises(InputError, match=word):
        replace(Instrument.of("120hz"), **changes)


@pytest.mark.parametrize(
    "changes", [{"diameter_um": 0.0}, {"jitter": 0.5}, {"transmission_sd": -0.1}, {"diameter_um": 5.0}]
)
def test_impossible_bundles_are_refused(changes: dict[str, float]) -> None:
    with pytest.raises(InputError, match=str(next(iter(changes.values())))):
        replace(Bundle(), **changes)


def test_bundle_has_its_pitch_transmission_and_size() -> None:
    cores = Bundle().cores()
    assert len(cores.rows_um) == pytest.approx(np.pi * 310**2 / (3.2**2 * np.sqrt(3) / 2), rel=0.01)
    assert cores.transmission.mean() == pytest.approx(1)
    assert cores.transmission.std() == pytest.approx(0.15, abs=0.005)
    assert (np.diff(cores.rows_um) >= 0).all()


@pytest.mark.parametrize("offset_um", [-29.0, 40.0])
def test_true_calibration_cancels_the_views_of_distal_light(offset_um: float) -> None:
    """Gain, rotation, scale and centres in the truth are those that were drawn."""
    right = ResidualView(gain=0.9, rotation_deg=0.3, scale=1.005)
    instrument = replace(Instrument.of("120hz", offset_um=offset_um), residual_view=right, black_dn=0.0)
    sectioner = Sectioner(true_calibration(instrument), instrument.frame_shape)
    ls, residual = sectioner_split(sectioner, Renderer(instrument, distal_light(), noise=False).render(0))
    assert np.abs(ls - residual).mean() < 0.06 * ls.mean()
    assert residual.sum() == pytest.approx(ls.sum(), rel=0.01)


def sectioner_split(sectioner: Sectioner, raw: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    inside = sectioner.inside
    return sectioner.ls(raw)[inside], sectioner.residual(raw)[inside]


@pytest.mark.parametrize("row", [200.0, 300.5])
def test_a_voltage_puts_the_line_onto_its_row_in_both_images(row: float) -> None:
    instrument = replace(Instrument.of("240hz"), line_tilt_deg=0.0, residual_view=ResidualView(1.0, 0.0, 1.0))
    volts = np.full(1, instrument.volts_at_row_zero + instrument.volts_per_row * row)
    (frame,) = calibration_scenes.standing_line(instrument, volts)
    signal = frame.astype(float) - 4
    half = frame.shape[1] // 2
    for view, expected in ((signal[:, :half], row), (signal[:, half:], row + instrument.offset_rows)):
        rows = np.arange(len(view))
        near = np.abs(rows - expected) < 8
        profile = view.sum(1) * near
        assert (profile * rows).sum() / profile.sum() == pytest.approx(expected, abs=0.3)


def test_noise_has_the_variance_of_shot_and_read_noise() -> None:
    instrument = Instrument.of("240hz")
    renderer = Renderer(instrument, scene("uniform"))
    frames = np.stack([renderer.render(k) for k in range(40)]).astype(np.float32)
    mean, variance = frames.mean(0), frames.var(0, ddof=1)
    for low, high in ((40, 60), (90, 110)):
        here = (mean > low) & (mean < high)
        signal_e = (mean[here].mean() - 4) * 40
        expected = (signal_e + 12**2) / 40**2 + 1 / 12
        assert variance[here].mean() == pytest.approx(expected, rel=0.05)
    dark = frames[:, :20, :].ravel()
    correlation = np.corrcoef(dark[:-1], dark[1:])[0, 1]
    assert abs(correlation) < 0.01


def test_wider_slits_gather_more_light_and_gain_costs_electrons() -> None:
    instrument = Instrument.of("240hz")
    three, six = (
        Renderer(replace(instrument, slit_rows=rows), scene("uniform"), noise=False).core_values(0)[0].mean()
        for rows in (3, 6)
    )
    assert 1.8 < six / three < 2
    louder = instrument.with_gain_db(6.0206)
    assert louder.light_dn == pytest.approx(2 * instrument.light_dn)
    assert louder.electrons_per_dn == pytest.approx(instrument.electrons_per_dn / 2)


def test_positions_are_camera_pixels_when_the_middle_row_is_read() -> None:
    instrument = Instrument.of("240hz", rate_hz=60)
    path = Straight(600.0, direction_deg=90)
    told = motion(instrument, path, 3)
    per_frame_px = 10 / instrument.optics.um_per_px
    assert np.array(told["positions"])[:, 0] == pytest.approx(per_frame_px * np.arange(4))
    late = instrument.confocal_centre[0] / instrument.optics.line_periods_per_frame
    assert np.array(told["positions_mid"])[:, 0] == pytest.approx(per_frame_px * (np.arange(3) + late))


def test_rows_are_read_at_their_own_time() -> None:
    """A probe that moves down the rows stretches the image: features come late by their row's share of the period."""
    instrument = Instrument.of("240hz")
    renderer = Renderer(instrument, scene("uniform"), Straight(4000.0, direction_deg=90))
    positions = renderer.row_positions_um(2)
    periods = 2 + np.arange(524) / instrument.optics.line_periods_per_frame
    assert positions[:, 0] == pytest.approx(4000 * periods * instrument.optics.frame_period_s)
