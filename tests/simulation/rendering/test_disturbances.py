"""Imperfections in rendered frames, each judged by what it does to grey levels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from napari_elsplus.simulation.model.imperfections import Imperfections
from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.simulation.rendering.renderer import Renderer
from napari_elsplus.simulation.rendering.views import views
from napari_elsplus.simulation.specimen.scenes import distal_light, empty, nuclei, uniform
from napari_elsplus.simulation.specimen.trajectories import Still, Straight
from napari_elsplus.simulation.truth import residual_to_confocal

PLAIN = {"electrons_per_dn": 1e9, "read_noise_e": 0.0, "line_tilt_deg": 0.0}
"""A camera without shot and read noise, and a level line."""
BLOCKS = [
    [17.1494, 9.3672, 38.0498, 16.8339, 41.2743, 17.5829, 24.0708, 9.8161],
    [4.001, 3.9996, 4.224, 4.3319, 4.1717, 4.0467, 3.9979, 4.0004],
    [25.1591, 31.4639, 55.9533, 54.9161, 57.6352, 53.5576, 33.3532, 24.6667],
]
"""Mean grey levels that frames of the ideal instrument had before imperfections were introduced; see the last tests."""
IMPERFECT_MEANS = [
    [16.301, 9.0619, 35.5127, 15.9029, 37.8165, 16.49, 23.0336, 9.6537],
    [17.0422, 9.4555, 35.1169, 15.7952, 38.7633, 16.9321, 23.0093, 9.8546],
    [4.1203, 4.1339, 4.3073, 4.3811, 4.1968, 4.117, 4.0828, 4.0995],
    [25.2288, 31.3778, 56.0498, 54.5543, 57.6527, 53.1628, 33.4094, 24.6091],
]
IMPERFECT_SDS = [
    [24.3754, 9.4069, 30.8292, 10.7881, 31.3498, 11.4835, 29.1708, 10.3147],
    [25.8877, 10.0952, 30.3033, 10.644, 32.1091, 11.8842, 29.0121, 10.5228],
    [3.1408, 3.4075, 3.5274, 2.9533, 2.8847, 3.5077, 2.71, 3.1493],
    [37.8155, 38.9816, 43.6806, 40.7504, 43.2335, 41.0434, 41.7569, 35.8721],
]
"""Mean and standard deviation of the grey levels of an imperfect instrument's frames before its light was computed in
fused kernels; see the last test."""


def instrument(text: str = "", **fields) -> Instrument:
    return Instrument.of("240hz", imperfections=Imperfections.parse(text), **fields)


def renderer(text: str = "", scene=None, trajectory=None, **fields) -> Renderer:
    return Renderer(instrument(text, **fields), scene or empty(), trajectory or Still(), seed=5)


def cores(text: str, scene=None, trajectory=None, frame: int = 0, line_rows=None, **fields) -> np.ndarray:
    made = renderer(text, scene or uniform(), trajectory, **(PLAIN | fields))
    return made.core_values(frame, line_rows=line_rows).copy().astype(np.float64)


def places() -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of the cores over the bundle's radius."""
    of = instrument().bundle
    known = of.cores()
    return known.rows_um / of.radius_um, known.cols_um / of.radius_um


def test_row_noise_shifts_whole_rows_and_differs_from_frame_to_frame() -> None:
    ideal, noisy = renderer(black_dn=20.0), renderer("row-noise=2", black_dn=20.0)
    first, second = (
        noisy.render(k).astype(float)[:, 1210:].mean(1) - ideal.render(k).astype(float)[:, 1210:].mean(1)
        for k in range(2)
    )
    assert first.std() == pytest.approx(2, rel=0.15)
    assert abs(np.corrcoef(first, second)[0, 1]) < 0.2
    assert (renderer("row-noise=2", black_dn=20.0).render(1) == noisy.render(1)).all()


@pytest.mark.parametrize(("text", "sd"), [("power-noise=5", 0.05), ("power-ripple=5", 0.05 / np.sqrt(2))])
def test_the_lasers_power_changes_the_same_rows_of_both_views_alike(text: str, sd: float) -> None:
    steady, flickering = (renderer(part, uniform(), light_dn=150.0, **PLAIN).render(0) for part in ("", text))
    rows = slice(200, 330)
    left, right = (
        flickering[rows, cols].astype(float).mean(1) / steady[rows, cols].astype(float).mean(1) - 1
        for cols in (slice(200, 460), slice(870, 1130))
    )
    assert left.std() == pytest.approx(sd, rel=0.2)
    assert np.corrcoef(left, right)[0, 1] > 0.99
    lamp = [renderer(part, distal_light(), **PLAIN).render(0) for part in ("", text)]
    assert (lamp[0] == lamp[1]).all()


def test_a_ripple_has_its_frequency() -> None:
    frequency_hz = 2300.0
    steady, rippled = (
        renderer(part, uniform(), light_dn=150.0, **PLAIN)
        for part in ("", f"power-ripple=10,ripple-frequency={frequency_hz}")
    )
    rows = slice(140, 400)
    power = [made.render(0)[rows, 250:410].astype(float).mean(1) for made in (steady, rippled)]
    spectrum = np.abs(np.fft.rfft(power[1] / power[0] - 1, 4096))
    line_period_s = steady.instrument.optics.line_period_s
    assert np.fft.rfftfreq(4096, line_period_s)[spectrum.argmax()] == pytest.approx(frequency_hz, rel=0.05)


@pytest.mark.parametrize("bow", [3.0, -3.0])
def test_a_bowed_line_lies_lower_at_the_rim(bow: float) -> None:
    rows, cols = places()
    made = instrument(f"line-bow={bow}", **PLAIN)
    standing = np.full(made.frame_shape[0], made.confocal_centre[0])
    light = cores(f"line-bow={bow}", line_rows=standing)[0] / made.bundle.cores().transmission
    for low in (0.0, 0.5, 0.8):
        beside = (np.abs(cols) >= low) & (np.abs(cols) < low + 0.1) & (np.abs(rows) < 0.5)
        centroid_rows = (light * rows)[beside].sum() / light[beside].sum() * made.diameter_px / 2
        assert centroid_rows == pytest.approx(bow * (low + 0.05) ** 2, abs=0.3)


def test_a_line_of_uneven_power_lights_its_ends_less() -> None:
    _, cols = places()
    even, uneven = (cores(text) for text in ("", "line-fall-off=30,line-slant=10"))
    for view in range(2):
        ratio = (uneven / even)[view]
        expected = 0.7 ** (cols**2) * (1 + 0.1 * cols)
        np.testing.assert_allclose(ratio, expected, rtol=1e-4)
    lamp = [cores(text, distal_light()) for text in ("", "line-fall-off=30,line-slant=10")]
    assert (lamp[0] == lamp[1]).all()


def test_a_distorted_view_moves_its_rim_by_its_share_of_the_radius_and_leaves_the_other_view() -> None:
    radius_px = instrument().diameter_px / 2
    ideal = views(instrument())
    for text, moved, still in (("left-distortion=1", 1, 2), ("right-distortion=1", 2, 1)):
        made = views(instrument(text))
        off = np.stack([made[moved].rows_px - ideal[moved].rows_px, made[moved].cols_px - ideal[moved].cols_px])
        rim = np.hypot(*places()) > 0.99
        assert np.hypot(*off[:, rim]).mean() == pytest.approx(0.01 * radius_px, rel=0.03)
        assert np.hypot(*off[:, np.hypot(*places()) < 0.5]).max() < 0.01 * radius_px / 7.5
        assert (made[still].rows_px == ideal[still].rows_px).all()


def test_the_lens_distorts_both_views_about_the_middle_of_the_sensor() -> None:
    ideal, made = views(instrument()), views(instrument("lens-distortion=1"))
    middle = np.array([261.5, 663.5])
    for view in (1, 2):
        places_px = np.stack([ideal[view].rows_px, ideal[view].cols_px], axis=1) - middle
        moved_px = np.stack([made[view].rows_px, made[view].cols_px], axis=1) - middle
        away = np.hypot(*places_px.T)
        np.testing.assert_allclose(np.hypot(*moved_px.T) / away - 1, 0.01 * (away / 664) ** 2, atol=1e-9)


def test_true_affine_of_distorted_views_is_the_best_one() -> None:
    made = instrument("right-distortion=0.5,lens-distortion=-0.5")
    _, left, right = views(made)
    matrix = np.array(residual_to_confocal(made))
    mapped = matrix @ np.stack([right.rows_px, right.cols_px, np.ones(len(right.rows_px))])
    left_over = np.stack([left.rows_px, left.cols_px]) - mapped
    assert np.abs(left_over.mean(1)).max() < 1e-9
    assert 0.1 < np.hypot(*left_over).mean() < 1.5


def test_gains_of_the_right_view_keep_their_mean_and_a_lamp_sees_another() -> None:
    ideal, made = (cores(text) for text in ("", "right-core-gain=10,right-vignette=5"))
    ratio = made / ideal
    assert (ratio[0] == 1).all()
    radius = np.hypot(*places())
    assert ratio[1].mean() == pytest.approx(1, abs=1e-4)
    assert ratio[1].std() == pytest.approx(0.1, rel=0.1)
    assert ratio[1][radius < 0.3].mean() - ratio[1][radius > 0.95].mean() == pytest.approx(0.09, abs=0.015)
    lamp, fluorescent = ((cores("lamp-gain=4", scene) / cores("", scene)) for scene in (distal_light(), uniform()))
    assert lamp[1] == pytest.approx(1.04, rel=1e-5)
    assert (lamp[0] == 1).all()
    assert (fluorescent == 1).all()


def test_pixels_differ_in_gain_and_hot_ones_shine_in_the_dark() -> None:
    dark = renderer("hot-pixels=0.1", **PLAIN, autofluorescence=0.0)
    hot = dark.render(0) > 20
    assert hot.mean() == pytest.approx(1e-3, rel=0.15)
    assert (hot == (dark.render(1) > 20)).all()
    even, uneven = (
        renderer(text, uniform(), light_dn=150.0, **PLAIN).render(0).astype(float) for text in ("", "prnu=3")
    )
    lit = even > 100
    assert (uneven[lit] / even[lit]).std() == pytest.approx(0.03, rel=0.15)


def test_a_ghost_displays_a_part_of_the_light_again_a_sixteenth_of_the_frame_to_the_right() -> None:
    alone, both = (
        renderer(text, uniform(), light_dn=80.0, **PLAIN).render(0).astype(float) for text in ("", "ghost=20")
    )
    displaced = alone.shape[1] // 16
    reflected = both - alone
    np.testing.assert_allclose(reflected[:, displaced:], 0.2 * (alone[:, :-displaced] - alone.min()), atol=1.01)
    assert not reflected[:, :displaced].any()


def test_a_specimen_bleaches_and_the_bundle_does_not() -> None:
    first, later = (cores("bleaching=20", uniform(), frame=frame) for frame in (0, 100))
    glass = cores("bleaching=20", empty(), frame=100)
    np.testing.assert_allclose(later - glass, 0.8 * (first - glass), rtol=1e-4)
    assert (glass == cores("", empty())).all()


def test_a_bent_bundle_transmits_otherwise_in_both_views_alike_once_the_probe_has_moved() -> None:
    straight, bent = (cores(text, uniform(), Straight(240_000), frame=2) for text in ("", "bundle-bending=5"))
    ratio = bent / straight  # 2 mm from where it began
    np.testing.assert_allclose(ratio[0], ratio[1], rtol=1e-5)
    assert ratio[0].std() == pytest.approx(0.05, rel=0.1)
    assert (cores("bundle-bending=5", uniform()) == cores("", uniform())).all()


def test_a_line_jitters_from_frame_to_frame() -> None:
    made = renderer("line-jitter=3", **PLAIN)
    standing = np.full(made.frame_shape[0], made.instrument.confocal_centre[0])
    rows = places()[0] * made.instrument.diameter_px / 2
    found = []
    for frame in range(12):
        light = made.core_values(frame, line_rows=standing)[0] / made.instrument.bundle.cores().transmission
        found.append((light * rows).sum() / light.sum())
    assert np.std(found) == pytest.approx(3, rel=0.5)


def test_perfect_sectioning_is_free_of_all_but_where_the_left_view_shows_a_core() -> None:
    drawn = Imperfections.drawn(4)
    made = replace(instrument(), imperfections=drawn)
    plain = replace(instrument(), imperfections=drawn.of_left_geometry)
    images = [Renderer(one, nuclei()).in_focus().render(3) for one in (made, plain)]
    assert (images[0] == images[1]).all()


def test_the_ideal_instrument_renders_what_it_did() -> None:
    """Mean grey levels of 131 x 664 px blocks in motion, of a standing line and of a lamp."""
    made = instrument()
    frames = (
        Renderer(made, nuclei(3), Straight(2000), seed=7).render(2),
        Renderer(made, empty(), seed=7).render(0, line_rows=np.full(524, 260.0)),
        Renderer(made, distal_light(), seed=7).render(0),
    )
    blocks = [frame.reshape(4, 131, 2, 664).mean((1, 3)).ravel() for frame in frames]
    np.testing.assert_allclose(blocks, BLOCKS, atol=0.005)


def test_an_imperfect_instrument_renders_what_it_did() -> None:
    """Grey levels of the blocks in motion (jitter computed, interpolated), of a standing line, and of a lamp."""
    made = replace(instrument(), imperfections=Imperfections.drawn(1))
    moving = Renderer(made, nuclei(3), Straight(2000), seed=7)
    frames = (
        moving.render(2),
        [moving.render(k) for k in range(3, 8)][-1],
        Renderer(made, empty(), seed=7).render(0, line_rows=np.full(524, 260.0)),
        Renderer(made, distal_light(), seed=7).render(0),
    )
    blocks = [frame.reshape(4, 131, 2, 664) for frame in frames]
    np.testing.assert_allclose([block.mean((1, 3)).ravel() for block in blocks], IMPERFECT_MEANS, atol=0.002)
    np.testing.assert_allclose([block.std((1, 3)).ravel() for block in blocks], IMPERFECT_SDS, atol=0.002)
