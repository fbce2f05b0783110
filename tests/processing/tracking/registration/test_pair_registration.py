from __future__ import annotations

from itertools import pairwise

import cv2
import numpy as np
import pytest

from motion_priors import about
from napari_elsplus.processing.tracking.front_end.front_end import FrontEnd
from napari_elsplus.processing.tracking.front_end.grid import Grid
from napari_elsplus.processing.tracking.motion.rolling_shutter import Displacement, RollingShutter, Velocity, Warp
from napari_elsplus.processing.tracking.registration.pair_registration import PairRegistration, PreparedFrame, Registrar
from recordings import fibres, grid_target, record, texture


def pair(
    scene: np.ndarray, before: tuple[float, float], after: tuple[float, float], **options: float
) -> tuple[Registrar, PreparedFrame, PreparedFrame, Warp, Displacement]:
    """Two successive frames of a probe with these velocities, their true warp and displacement."""
    start = np.array(scene.shape) / 2
    starts = np.stack([start, start + before, start + before + np.array(after)])
    truth = record(scene, starts, **options)  # type: ignore[arg-type]
    front_end = FrontEnd(truth.calibration, truth.frames.shape[1:])
    registrar = Registrar(front_end.grid)
    views = []
    for frame in truth.frames:
        view = registrar.view()
        front_end.image(frame, view.image)
        views.append(registrar.prepare(view))
    shutter = front_end.grid.shutter
    moved = Displacement(*(truth.positions[1] - truth.positions[0]) / front_end.grid.binning)
    return registrar, views[0], views[1], shutter.warp(Velocity(*before), Velocity(*after), moved), moved


def displacement(registrar: Registrar, link: PairRegistration) -> Displacement:
    shutter = registrar.grid.shutter
    return shutter.displacement(link.warp, shutter.velocities(link.warp)[1])


@pytest.mark.parametrize("speed", [(0.0, 0.0), (3.0, -2.0), (24.0, 18.0), (-20.0, 25.0)])
def test_displacement_of_a_fast_accelerating_probe_to_a_twentieth_of_a_pixel(speed: tuple[float, float]) -> None:
    after = (speed[0] + 2.0, speed[1] - 3.0)
    registrar, a, b, _, truth = pair(texture(600, 1), speed, after)
    start = registrar.grid.shutter.warp(Velocity(*speed), Velocity(*speed), Displacement(*speed))
    link = registrar.register(a, b, about(registrar.grid.shutter, start))
    assert link.observed
    assert np.abs(np.subtract(displacement(registrar, link), truth)).max() < 0.05


def test_all_shifts_are_searched() -> None:
    """Without any idea of the motion, up to 60 % of the disc."""
    registrar, a, b, _, truth = pair(texture(800, 2), (90.0, -85.0), (90.0, -85.0))
    link = registrar.register(a, b, about(registrar.grid.shutter, Warp(), shift_px=60.0), anywhere=True)
    assert link is not None
    assert np.abs(np.subtract(displacement(registrar, link), truth)).max() < 0.3


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("period_px", [13.3, 19.1])
def test_a_grid_of_lines_that_are_not_quite_alike_is_found_where_it_is(period_px: float, seed: int) -> None:
    """A multiple of the period away the frames correlate nearly as well, and more pixels of a coarse search meet."""
    speed = (1.0, 0.78 * period_px)
    registrar, a, b, _, truth = pair(grid_target(700, period_px, 0.06, seed), speed, speed)
    link = registrar.register(a, b, about(registrar.grid.shutter, Warp(), shift_px=50.0), anywhere=True)
    assert np.abs(np.subtract(displacement(registrar, link), truth)).max() < 0.1
    assert link.observed


@pytest.mark.parametrize("part", [0.2, 0.5, 0.78])
@pytest.mark.parametrize("period_px", [7.0, 8.0, 9.0, 10.0, 13.3, 19.1])
def test_a_grid_of_lines_that_are_alike_tells_no_shift(period_px: float, part: float) -> None:
    """Of fine grids more shifts are alike than can be compared: one 84 px off was accepted."""
    speed = (1.0, part * period_px)
    registrar, a, b, _, _ = pair(grid_target(700, period_px, 0.0, 0), speed, speed, haze=0.0)
    link = registrar.register(a, b, about(registrar.grid.shutter, Warp(), shift_px=50.0), anywhere=True)
    assert not link.observed


def test_covariance_is_honest() -> None:
    """Errors over many noisy pairs are as large as the covariance says, within a factor of two."""
    scene = texture(600, 3)
    normalised = []
    for seed in range(12):
        registrar, a, b, true, _ = pair(scene, (15.0, 8.0), (15.0, 8.0), photons=60.0, seed=seed)
        link = registrar.register(a, b, about(registrar.grid.shutter, true))
        miss = np.array([link.warp.b - true.b, link.warp.d - true.d])
        normalised.append(miss @ np.linalg.solve(link.covariance, miss) / 2)
    assert 0.25 < np.mean(normalised) < 4


@pytest.mark.parametrize(("contrast", "speed"), [(0.06, (3.0, 2.0)), (0.1, (-2.0, 4.0))])
def test_smooth_tissue_of_low_contrast_is_registered_as_well_as_is_stated(
    contrast: float, speed: tuple[float, float]
) -> None:
    """Structures larger than what is taken out as smooth: what is left of them ends at the rim of the window."""
    rng = np.random.default_rng(12)
    grid = Grid(204, 1, (0, 0), (101.4, 101.6), 199.0, RollingShutter(230.0))
    registrar, views = Registrar(grid), []
    scene = cv2.GaussianBlur(rng.standard_normal((700, 700)).astype(np.float32), (0, 0), 13)
    scene = 45 * (1 + contrast * scene / scene.std())
    true = grid.shutter.warp(Velocity(*speed), Velocity(*speed), Displacement(*speed))
    y, x = (np.arange(grid.side) - c for c in grid.centre)
    for k in range(12):
        at_x = x[None] + (300 + speed[1] * (k + y / 230))[:, None]
        at_y = np.broadcast_to((y + 300 + speed[0] * (k + y / 230))[:, None], at_x.shape)
        frame = cv2.remap(scene, at_x.astype(np.float32), at_y.astype(np.float32), cv2.INTER_CUBIC)
        noise = rng.normal(0, 0.55, frame.shape).astype(np.float32)
        views.append(registrar.view())
        views[-1].image[:] = frame + cv2.sepFilter2D(noise, -1, *2 * (np.array([1, 4, 6, 4, 1]) / 16,))
        registrar.prepare(views[-1])
    normalised = []
    for a, b in pairwise(views):
        link = registrar.register(a, b, about(grid.shutter, Warp(), shift_px=20.0))
        miss = np.array([link.warp.b - true.b, link.warp.d - true.d])
        assert np.abs(miss).max() < 0.15
        normalised.append(miss @ np.linalg.solve(link.covariance, miss) / 2)
    assert np.mean(normalised) < 2


@pytest.mark.parametrize("gain", [0.3, 0.5, 0.7, 1.8, 2.2, 3.0])
def test_gain_and_offset_between_frames_do_not_matter(gain: float) -> None:
    """Steps of Lucas-Kanade move the image of the template, gain times as bright as the template."""
    for seed in range(4, 8):
        registrar, a, b, true, truth = pair(texture(600, seed), (12.0, 5.0), (12.0, 5.0))
        start = true._replace(b=true.b + 1.5, d=true.d - 1.5)
        plain = registrar.register(a, b, about(registrar.grid.shutter, start))
        b.image[:] = np.where(b.image != 0, gain * b.image + 20, 0)
        link = registrar.register(a, registrar.prepare(b), about(registrar.grid.shutter, start))
        assert np.abs(np.subtract(displacement(registrar, link), truth)).max() < 0.05
        assert np.abs(np.subtract(displacement(registrar, link), displacement(registrar, plain))).max() < 0.02
        assert link.sigma == pytest.approx(plain.sigma, rel=0.2)


def one_fibre(side: int) -> np.ndarray:
    """A straight fibre across the whole scene: motion along it shows nowhere."""
    row, col = np.mgrid[:side, :side] - side / 2
    across = 0.8 * row - 0.6 * col
    return np.exp(-0.5 * (across / 3) ** 2).astype(np.float32)


def test_motion_along_a_single_fibre_is_not_observed() -> None:
    registrar, a, b, true, _ = pair(one_fibre(600), (10.0, 8.0), (10.0, 8.0))
    slid = true._replace(b=true.b - 3.6, d=true.d - 4.8)
    for start in (true, slid):
        link = registrar.register(a, b, about(registrar.grid.shutter, start))
        assert link.correlation > 0.9
        assert not link.observed


def test_crossing_fibres_are_observed() -> None:
    registrar, a, b, true, _ = pair(fibres(600, 60, 5), (10.0, 8.0), (10.0, 8.0))
    assert registrar.register(a, b, about(registrar.grid.shutter, true)).observed


@pytest.mark.parametrize("level", [0.0, 255.0])
def test_frames_without_structure_are_not_observed(level: float) -> None:
    registrar, a, b, true, _ = pair(texture(600, 6), (0.0, 0.0), (0.0, 0.0))
    for view in (a, b):
        view.image[:] = level
        registrar.prepare(view)
    assert not registrar.register(a, b, about(registrar.grid.shutter, true)).observed
    found = registrar.register(a, b, about(registrar.grid.shutter, true, shift_px=20.0), anywhere=True)
    assert found is None or not found.observed


def waves(grid: Grid, row: float, col: float, seed: int, lengths: tuple[float, float] = (0.2, 1.3)) -> np.ndarray:
    """Structure of these wave numbers, radians per pixel, known everywhere, seen on the grid from (row, col)."""
    random = np.random.default_rng(seed)
    rows, cols = np.mgrid[: grid.side, : grid.side].astype(float)
    angle, phase = random.uniform(0, 2 * np.pi, (2, 120))
    length = random.uniform(*lengths, 120)
    image = sum(
        np.cos(k * (np.sin(a) * (rows + row) + np.cos(a) * (cols + col)) + p)
        for k, a, p in zip(length, angle, phase, strict=True)
    )
    return np.asarray(image, np.float32)


def linked(grid: Grid, images: tuple[np.ndarray, np.ndarray], shift: tuple[float, float]) -> np.ndarray:
    """How far the link of two images misses the shift between them."""
    registrar = Registrar(grid)
    first, last = grid.spans(1.0)
    col = np.arange(grid.side)
    lit = (col >= first[:, None]) & (col < last[:, None])
    views = [registrar.view() for _ in images]
    for view, image in zip(views, images, strict=True):
        view.image[:] = np.where(lit, image, 0)
        registrar.prepare(view)
    link = registrar.register(*views, about(grid.shutter, Warp(1.0, -shift[0], 0.0, -shift[1])))
    assert link.observed
    return np.array([-link.warp.b - shift[0], -link.warp.d - shift[1]])


GRID = Grid(244, 2, (0, 0), (121.5, 121.5), 236.0, RollingShutter(np.inf))


def test_noise_finer_than_the_structure_is_no_information() -> None:
    """Gradients of noise, which frames do not share, would add up to a certainty."""
    shift, binomial, normalised = (3.3, -2.6), np.array([1, 4, 6, 4, 1]) / 16, []
    true = Warp(1.0, -shift[0], 0.0, -shift[1])
    for seed in range(12):
        random, registrar, views = np.random.default_rng(seed), Registrar(GRID), []
        for row, col in ((0.0, 0.0), shift):
            noise = cv2.sepFilter2D(random.normal(size=(GRID.side, GRID.side)), -1, binomial, binomial)
            view = registrar.view()
            view.image[:] = 10 * waves(GRID, row, col, seed, (0.05, 0.2)) + 60 * noise
            views.append(registrar.prepare(view))
        link = registrar.register(views[0], views[1], about(GRID.shutter, true))
        miss = np.array([link.warp.b - true.b, link.warp.d - true.d])
        normalised.append(miss @ np.linalg.solve(link.covariance, miss) / 2)
    assert 0.05 < np.mean(normalised) < 1.5


def test_an_even_speed_does_not_add_up_errors() -> None:
    """Over many scenes the mean error at one sub-pixel phase is below a five-hundredth of a pixel."""
    shift = 6.25, 10.25
    missed = [linked(GRID, (waves(GRID, 0, 0, seed), waves(GRID, *shift, seed)), shift) for seed in range(6)]
    assert np.abs(np.mean(missed, axis=0)).max() < 0.002


def test_what_does_not_move_at_the_rim_does_not_hold_a_sharp_link_back() -> None:
    """Haze beside the rim, stronger than the scene's structure, that stays where it is."""
    y, x = (np.mgrid[: GRID.side, : GRID.side] - GRID.centre[0]) / (GRID.diameter / 2)
    haze = 12 * np.clip((np.hypot(y, x) - 0.82) / 0.08, 0, 1).astype(np.float32) * (y < 0)
    shift = -14.0, 0.0
    missed = [
        linked(GRID, (waves(GRID, 0, 0, seed) + haze, waves(GRID, *shift, seed) + haze), shift) for seed in range(4)
    ]
    assert np.abs(np.mean(missed, axis=0)).max() < 0.002
