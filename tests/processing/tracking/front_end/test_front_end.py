from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest

from napari_elsplus.errors import CalibrationError, InputError
from napari_elsplus.instrument.calibration import Calibration
from napari_elsplus.processing.calibration.measurements import measure_flat_field
from napari_elsplus.processing.images.sectioning import Mode
from napari_elsplus.processing.tracking.front_end.front_end import FrontEnd
from napari_elsplus.processing.tracking.front_end.grid import Grid

SHAPE = (524, 1328)
LEFT, RIGHT = np.array([261.3, 300.7]), np.array([255.1, 900.4])


def calibration(diameter: float = 464.0, turn_deg: float = 0.0, scale: float = 1.0, **more: Any) -> Calibration:
    t = np.deg2rad(turn_deg)
    turn = scale * np.array([(np.cos(t), -np.sin(t)), (np.sin(t), np.cos(t))])
    bundle = {
        "confocal_centre": LEFT.tolist(),
        "residual_centre": RIGHT.tolist(),
        "diameter_px": diameter,
        "residual_to_confocal": np.column_stack([turn, LEFT - turn @ RIGHT]).tolist(),
    } | more
    return Calibration.parse({"bundle": bundle})


def inside(grid: Grid, field: float = 0.95) -> np.ndarray:
    first, last = grid.spans(field)
    columns = np.arange(grid.side)
    return (columns >= first[:, None]) & (columns < last[:, None])


@pytest.mark.parametrize("diameter", [200.0, 464.0, 650.0])
@pytest.mark.parametrize(("turn_deg", "scale"), [(0.0, 1.0), (0.3, 1.005), (-0.5, 0.99)])
def test_residual_is_taken_from_where_the_calibration_maps_it(diameter: float, turn_deg: float, scale: float) -> None:
    """On a linear image bilinear binning and smoothing are exact, so the position is checked to rounding."""
    shape = (800, 1500)
    record = calibration(diameter, turn_deg, scale)
    shift = np.array([120.0, 60.0])
    content = record.content()
    for name in ("confocal_centre", "residual_centre"):
        content["bundle"][name] = (np.array(content["bundle"][name]) + shift).tolist()
    matrix = np.array(content["bundle"]["residual_to_confocal"])
    matrix[:, 2] += shift - matrix[:, :2] @ shift
    content["bundle"]["residual_to_confocal"] = matrix.tolist()
    row, col = np.mgrid[: shape[0], : shape[1]].astype(np.float32)
    front_end = FrontEnd(Calibration.parse(content), shape, Mode.RESIDUAL)
    grid = front_end.grid
    image = front_end.image(0.3 * row + 0.2 * col, np.empty((grid.side, grid.side), np.float32))
    y, x = (
        o + grid.binning * i + (grid.binning - 1) / 2
        for o, i in zip(grid.origin, np.mgrid[: grid.side, : grid.side], strict=True)
    )
    there = np.linalg.inv(np.vstack([matrix, (0, 0, 1)])) @ np.stack([y.ravel(), x.ravel(), np.ones(y.size)])
    expected = (0.3 * there[0] + 0.2 * there[1]).reshape(y.shape)
    assert np.abs(image - expected)[inside(grid)].max() < 1e-3


def test_els_is_ls_minus_residual_over_gain_and_keeps_its_sign() -> None:
    rng = np.random.default_rng(1)
    raw = rng.integers(0, 255, SHAPE, dtype=np.uint8)
    record = calibration(residual_gain=0.93)
    image = {}
    for mode in (Mode.LS, Mode.RESIDUAL, Mode.ELS):
        front_end = FrontEnd(record, SHAPE, mode)
        image[mode] = front_end.image(raw, np.empty((front_end.grid.side,) * 2, np.float32)).copy()
    np.testing.assert_allclose(image[Mode.ELS], image[Mode.LS] - image[Mode.RESIDUAL], atol=1e-3)
    assert image[Mode.ELS][inside(front_end.grid)].min() < 0


def test_background_and_flat_leave_the_scene() -> None:
    record = calibration(280.0)
    side = 284
    row, col = np.mgrid[: SHAPE[0], : SHAPE[1]]
    vignette = 1.2 - 0.5 * ((row - LEFT[0]) ** 2 + (col - LEFT[1]) ** 2) / 140**2
    background = (7 + 0.01 * col).astype(np.float32)
    middle = np.arange(side) - (side - 1) / 2
    flat = (1.2 - 0.5 * (middle[:, None] ** 2 + middle**2) / 140**2).astype(np.float32)
    record = record.model_copy(update={"background": background, "flat": flat})
    front_end = FrontEnd(record, SHAPE, Mode.LS)
    raw = (50 * vignette + background).astype(np.float32)
    image = front_end.image(raw, np.empty((front_end.grid.side,) * 2, np.float32))
    assert np.abs(image - 50)[inside(front_end.grid, 0.9)].max() < 0.2


def test_light_of_a_cluster_of_dead_cores_is_not_left_dark() -> None:
    """It would stand still in all frames, and be followed; what cores around it add there is a tenth of the light."""
    middle = np.arange(293) - 146
    dead = np.hypot(middle[:, None] - 20, middle - 30) < 12
    flat = np.where(dead, 0.1, 1.0).astype(np.float32)
    record = calibration(280.0).model_copy(update={"flat": flat})
    raw = np.zeros(SHAPE, np.float32)
    at = np.round(LEFT).astype(int) - 146
    raw[at[0] : at[0] + 293, at[1] : at[1] + 293] = 1000 * flat
    front_end = FrontEnd(record, SHAPE, Mode.LS)
    grid = front_end.grid
    image = front_end.image(raw, np.empty((grid.side, grid.side), np.float32))
    y, x = np.mgrid[: grid.side, : grid.side]
    cluster = np.hypot(y - grid.centre[0] - 20, x - grid.centre[1] - 30) < 8
    assert np.abs(image[cluster] / 1000 - 1).max() < 0.1


@pytest.mark.parametrize(("diameter", "pitch_px"), [(400.0, 2.6), (280.0, 2.4)])
def test_flat_field_leaves_none_of_the_pattern_of_the_cores(diameter: float, pitch_px: float) -> None:
    """Smooth tissue has a texture of a few per cent, and a pattern that stays holds its registration back."""
    rng = np.random.default_rng(4)
    j, i = np.mgrid[-150:151, -150:151]
    y, x = pitch_px * np.stack([0.866 * j, i + 0.5 * (j % 2)]).reshape(2, -1) + rng.normal(0, 0.3, (2, j.size))
    lit = np.hypot(y, x) < diameter / 2
    y, x, light = LEFT[0] + y[lit], LEFT[1] + x[lit], rng.normal(1, 0.15, lit.sum())
    frame = np.zeros(SHAPE)
    for down, aside in np.ndindex(9, 9):
        row, col = np.rint(y).astype(int) + down - 4, np.rint(x).astype(int) + aside - 4
        np.add.at(frame, (row, col), 300 * light * np.exp(-((row - y) ** 2 + (col - x) ** 2) / (0.18 * pitch_px**2)))
    record = calibration(diameter)
    record = record.model_copy(update={"flat": measure_flat_field(frame[None].astype(np.float32), record)})
    front_end = FrontEnd(record, SHAPE, Mode.LS)
    image = front_end.image(frame.astype(np.float32), np.empty((front_end.grid.side,) * 2, np.float32))
    fine = (image - cv2.GaussianBlur(image, (0, 0), 3))[inside(front_end.grid, 0.8)]
    assert fine.std() < 0.001 * image[inside(front_end.grid, 0.8)].mean()


def test_bundle_is_binned_to_about_one_pixel_per_core() -> None:
    for diameter, binning in ((150.0, 1), (270.0, 1), (464.0, 2), (650.0, 3)):
        grid = Grid.of(calibration(diameter))
        assert grid.binning == binning
        centre = [o + (binning - 1) / 2 + binning * c for o, c in zip(grid.origin, grid.centre, strict=True)]
        assert centre == pytest.approx(LEFT)


@pytest.mark.parametrize(("pitch_px", "binning"), [(2.4, 1), (3.3, 1), (5.4, 3), (7.0, 4), (9.0, 5)])
def test_few_cores_are_binned_further(pitch_px: float, binning: int) -> None:
    """Otherwise each frame shows the same steps at the rims of the cores, and the track lags behind the probe."""
    rng = np.random.default_rng(0)
    j, i = np.mgrid[: int(284 / pitch_px / 0.866), : int(284 / pitch_px)]
    at = pitch_px * np.stack([0.866 * j, i + 0.5 * (j % 2)]).reshape(2, -1) + rng.normal(0, 0.1 * pitch_px, (2, j.size))
    rows, cols = np.exp(-((np.arange(284)[:, None] - at[:, None]) ** 2) / (2 * (0.3 * pitch_px) ** 2))
    flat = rows @ cols.T
    assert Grid.of(calibration(280.0).model_copy(update={"flat": np.asarray(flat, np.float32)})).binning == binning
    assert Grid.of(calibration(280.0).model_copy(update={"flat": np.ones((284, 284), np.float32)})).binning == 1


def test_rows_per_frame_are_counted_on_the_grid() -> None:
    content = calibration().content() | {"optics": {"rows_per_frame": 544.8}}
    grid = Grid.of(Calibration.parse(content))
    assert grid.shutter.line_periods_per_frame == pytest.approx(272.4)
    assert np.isinf(Grid.of(calibration()).shutter.line_periods_per_frame)


def test_views_outside_of_the_frame_are_refused() -> None:
    with pytest.raises(CalibrationError, match="outside of the 250 x 1328 frame"):
        FrontEnd(calibration(), (250, 1328))
    with pytest.raises(CalibrationError, match="background"):
        FrontEnd(calibration().model_copy(update={"background": np.zeros((9, 9), np.float32)}), SHAPE)


def test_frames_of_another_size_are_refused() -> None:
    front_end = FrontEnd(calibration(), SHAPE)
    out = np.empty((front_end.grid.side,) * 2, np.float32)
    for frames in ((np.zeros((300, 600), np.uint8),), (np.zeros(SHAPE, np.uint8), out, np.zeros((9, 9), np.uint8))):
        with pytest.raises(InputError, match="all frames of a recording must have one size"):
            front_end.image(frames[0], out, *frames[2:])


@pytest.mark.parametrize("rows", [1, 20])
def test_views_cut_by_the_frame_are_tracked_on_what_both_show(rows: int) -> None:
    raw = np.random.default_rng(3).integers(0, 255, SHAPE, dtype=np.uint8)
    record = calibration()
    first = int(RIGHT[0] - 464 / 2) + rows
    content = record.content()
    for name in ("confocal_centre", "residual_centre"):
        content["bundle"][name] = (np.array(content["bundle"][name]) - (first, 0)).tolist()
    content["bundle"]["residual_to_confocal"][0][2] = float((LEFT - RIGHT)[0])
    whole = FrontEnd(record, SHAPE)
    cut = FrontEnd(Calibration.parse(content), (SHAPE[0] - first, SHAPE[1]))
    assert whole.grid.seen is None
    used = inside(cut.grid)
    assert 0.8 < used.sum() / inside(whole.grid).sum() < 1
    assert not used[: rows // 2].any()
    images = [
        front_end.image(frame, np.empty((whole.grid.side,) * 2, np.float32))
        for front_end, frame in ((whole, raw), (cut, raw[first:]))
    ]
    well_inside = cv2.erode(used.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    assert np.abs(images[1] - images[0])[well_inside].max() < 1e-3


@pytest.mark.parametrize(
    ("edges", "seen"),
    [
        (("top",), (22, 234, 2, 234)),
        (("bottom",), (2, 213, 2, 234)),
        (("left",), (2, 234, 22, 234)),
        (("right",), (2, 234, 2, 213)),
        (("top", "left"), (22, 234, 22, 234)),
    ],
)
def test_only_what_an_edge_cuts_is_left_out(edges: tuple[str, ...], seen: tuple[int, ...]) -> None:
    """Of a disc that was cut at its side, the rows from the top down to its middle were left out instead."""
    radius, cut_px, shape, centre = 232, 40, list(SHAPE), LEFT.tolist()
    for axis, (near, far) in enumerate((("top", "bottom"), ("left", "right"))):
        if near in edges:
            centre[axis] -= int(LEFT[axis] - radius) + cut_px
        if far in edges:
            shape[axis] = int(LEFT[axis]) + radius - cut_px
    shift = np.column_stack([np.eye(2), centre - RIGHT]).tolist()
    record = calibration(confocal_centre=centre, residual_to_confocal=shift)
    assert FrontEnd(record, (shape[0], shape[1]), Mode.LS).grid.seen == seen


def test_half_views_are_refused() -> None:
    with pytest.raises(CalibrationError, match=r"of the bundle's views lie outside of the 240 x 1328 frame"):
        FrontEnd(calibration(), (240, 1328))
