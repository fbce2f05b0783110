"""The laser line: true to a few hundredths of a row, honest about it, and refused where there is none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.rigs.random_rigs import Rig
from napari_elsplus.errors import MeasurementError
from napari_elsplus.processing.calibration.line.location import Line, locate_line

RIG = Rig(left=(100.0, 98.0), right=(91.0, 302.5), diameter_px=180.0, line_rows=2.2, tilt_deg=1.0)
ROW = 3.3
SPLIT = 200


def view(rig: Rig = RIG, row: float = ROW) -> np.ndarray:
    return rig.line(1, row)[0][:, :SPLIT]


def sigmas_off(line: Line, rig: Rig = RIG, row: float = ROW) -> float:
    column = rig.left[1]
    return abs(line.row_at(column) - (rig.left[0] + row)) / line.uncertainty_rows(column)


@given(
    row=st.floats(20, 60),
    slope=st.floats(-0.035, 0.035),
    width=st.floats(0.9, 4.0),
    height=st.floats(20, 5000),
    floor=st.floats(-5, 200),
)
@settings(max_examples=40, deadline=None)
def test_a_noiseless_line_is_found_exactly(row: float, slope: float, width: float, height: float, floor: float) -> None:
    y, x = np.mgrid[:80, :120]
    line = locate_line(floor + height * np.exp(-((y - row - slope * (x - 59.5)) ** 2) / (2 * width**2)))
    assert line.row_at(59.5) == pytest.approx(row, abs=0.01)
    assert line.slope == pytest.approx(slope, abs=1e-3)
    assert line.width_rows == pytest.approx(width, rel=0.05)


@pytest.mark.parametrize("width", [1.2, 2.5])
@pytest.mark.parametrize("bow_rows", [-5.0, 2.2, 5.0])
def test_a_bowed_line_is_located_to_a_hundredth_of_a_row(bow_rows: float, width: float) -> None:
    """One step from the straight line left 0.03 to 1 row at the vertex, more the longer the chord."""
    y, x = np.mgrid[:80, :240]
    u = x - 119.5
    for half in (75, 105):
        curve = 41.3 + 0.01 * u + bow_rows * (u / 105) ** 2
        light = 3 + 90 * np.exp(-((y - curve) ** 2) / (2 * width**2)) * (abs(u) < half)
        line = locate_line(light)
        for found in (line, locate_line(light, near=line)):
            assert 105**2 * found.bend == pytest.approx(bow_rows, rel=0.01)
            assert found.row_at(119.5) - found.bend * found.mean_square_px == pytest.approx(41.3, abs=0.01)
            assert found.slope == pytest.approx(0.01, abs=2e-4)
            assert found.width_rows == pytest.approx(width, rel=0.03)


def test_a_line_whose_light_varies_by_half_each_way_along_it_is_located_whole() -> None:
    """Of columns below half of the usual light it was cut, and its tilt off by 0.6 degrees in two of 64 rigs."""
    y, x = np.mgrid[:80, :240]
    u = x - 119.5
    light = (1 + 0.45 * np.cos(u / 8)) * np.exp(-((y - 41.3 - 0.01 * u) ** 2) / 8) * (abs(u) < 100)
    first, stop = locate_line(3 + 90 * light).columns
    assert stop - first == pytest.approx(200, abs=4)


def test_a_diverged_bow_is_not_followed() -> None:
    """At the bundle's rim a fit to no line at all had a bend of 1e109, and the next one began there."""
    line = locate_line(view(RIG))
    assert replace(line, bend=1e109).streak.bend == 0
    assert replace(line, bend=1 / line.mean_square_px).streak.bend > 0


@pytest.mark.parametrize("tilt_deg", [-2.0, 0.0, 2.0])
def test_tilt_is_measured_and_does_not_bias_the_row(tilt_deg: float) -> None:
    rig = replace(RIG, tilt_deg=tilt_deg)
    line = locate_line(view(rig))
    assert line.tilt_deg == pytest.approx(tilt_deg, abs=0.1)
    assert line.row_at(rig.left[1]) == pytest.approx(rig.left[0] + ROW, abs=0.08)


@pytest.mark.parametrize("photons", [5.0, 10.0, 30.0])
def test_dim_lines_are_found_with_a_wider_uncertainty(photons: float) -> None:
    rig = replace(RIG, photons=photons, electrons_per_dn=1.0, read_noise_e=1.0)
    line = locate_line(view(rig))
    assert sigmas_off(line, rig) < 3
    assert line.uncertainty_rows() > locate_line(view()).uncertainty_rows()


def test_uncertainty_falls_with_light_until_only_the_cores_are_left() -> None:
    spread = [
        locate_line(view(replace(RIG, photons=photons, electrons_per_dn=photons / 100))).uncertainty_rows()
        for photons in (20.0, 2_000.0, 200_000.0)
    ]
    assert spread[0] > 1.3 * spread[1]
    assert spread[2] > 0.3 * spread[1]


def disturbed(kind: str) -> np.ndarray:
    image = view().copy()
    random = np.random.default_rng(1)
    match kind:
        case "hot pixels":
            image[random.integers(0, len(image), 40), random.integers(0, SPLIT, 40)] = 255
        case "hot column":
            image[:, 77] = 255
        case "hot row":
            image[30] = np.maximum(image[30], 60)
        case "saturated":
            image = np.clip(image.astype(float) * 12 - 40, 0, 255).astype(np.uint8)
        case "right half blocked":
            image[:, 110:] = 4
        case "reflections":
            light = RIG.lit_by_line(ROW) + 0.6 * RIG.lit_by_line(-40) + 0.3 * RIG.lit_by_line(40)
            image = (light[:, :SPLIT] / RIG.electrons_per_dn + 4).astype(np.uint8)
        case "16 bit":
            image = (RIG.lit_by_line(ROW)[:, :SPLIT] * 20 + 100).astype(np.uint16)
    return image


@pytest.mark.parametrize(
    "kind",
    [
        *("hot pixels", "hot column", "hot row", "saturated", "right half blocked"),
        *("reflections", "16 bit"),
    ],
)
def test_what_disturbs_a_line_is_either_ignored_or_owned_up_to(kind: str) -> None:
    assert sigmas_off(locate_line(disturbed(kind))) < 3


def test_a_reflection_beside_the_line_moves_it_little_and_the_offset_less() -> None:
    light = RIG.lit_by_line(ROW) + 0.4 * RIG.lit_by_line(ROW - 12)
    frame = (light / RIG.electrons_per_dn + 4).astype(np.uint8)
    left, right = locate_line(frame[:, :SPLIT]), locate_line(frame[:, SPLIT:])
    row = left.row_at(RIG.left[1])
    assert row == pytest.approx(RIG.left[0] + ROW, abs=0.2)
    assert right.row_at(RIG.right[1] - SPLIT) - row == pytest.approx(RIG.offset_rows(ROW), abs=0.03)


def test_a_line_near_the_rim_is_not_pulled_by_its_cut_halo() -> None:
    rig = replace(RIG, halo_share=0.55, halo_rows=25.0)
    for row in (-60.0, 60.0):
        line = locate_line(view(rig, row))
        assert line.row_at(rig.left[1]) == pytest.approx(rig.left[0] + row, abs=0.12)


def test_background_frame_is_taken_off() -> None:
    image = view()
    pattern = np.zeros(image.shape, np.float32)
    pattern[60:64] = 90
    lit = (image + pattern).astype(np.uint8)
    assert sigmas_off(locate_line(lit)) > 100
    assert sigmas_off(locate_line(lit, pattern)) < 3


def no_line(kind: str) -> np.ndarray:
    y, x = np.mgrid[:160, :SPLIT]
    noise = np.random.default_rng(3).normal(8, 2, (160, SPLIT))
    return {
        "black": np.zeros((160, SPLIT), np.uint8),
        "white": np.full((160, SPLIT), 255, np.uint8),
        "noise": noise,
        "bundle lit from the far end": RIG.bundle()[0][:, :SPLIT],
        "spot": noise + 200 * np.exp(-((y - 80) ** 2 + (x - 100) ** 2) / 60),
        "edge of a lit half": noise + 100 * (y > 80),
        "broad glow": noise + 100 * np.exp(-((y - 80) ** 2) / (2 * 30**2)),
        "too small": np.zeros((10, 20)),
    }[kind]


@pytest.mark.parametrize(
    "kind",
    ["black", "white", "noise", "bundle lit from the far end", "spot", "edge of a lit half", "broad glow", "too small"],
)
def test_what_is_no_line_is_refused(kind: str) -> None:
    with pytest.raises(MeasurementError, match=r"^no laser line: .+: "):
        locate_line(no_line(kind))


def test_noise_alone_never_makes_a_line() -> None:
    random = np.random.default_rng(5)
    for _ in range(40):
        with pytest.raises(MeasurementError):
            locate_line(random.poisson(5, (120, 160)).astype(np.uint8))


@pytest.mark.parametrize(
    ("seed", "shape", "level"),
    [
        (1302, (69, 172), 10.0),
        (2671, (116, 91), 10.0),
        (2926, (36, 240), 10.0),
        (1302, (69, 172), 3.99001571517477),
        (2671, (116, 91), 7.345236869322278),
        (2926, (36, 240), 2.264265662566991),
    ],
)
def test_a_bright_row_of_a_frame_without_a_line_is_refused_also_where_the_fit_diverges(
    seed: int, shape: tuple[int, int], level: float
) -> None:
    """A fit that turned away from all columns, or from nearly all, raised an error of linear algebra."""
    random = np.random.default_rng(seed)
    random.integers(20, 120), random.integers(40, 300)
    image = random.normal(0, 1, shape)
    random.integers(0, 4)
    image[int(random.integers(0, len(image)))] += level
    with pytest.raises(MeasurementError, match="no laser line"):
        locate_line(image.astype(np.float32))
