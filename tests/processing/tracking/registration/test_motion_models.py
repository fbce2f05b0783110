from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import pytest

from motion_priors import about
from napari_elsplus.processing.tracking.front_end.grid import Grid
from napari_elsplus.processing.tracking.motion.rolling_shutter import Displacement, RollingShutter, Velocity, Warp
from napari_elsplus.processing.tracking.registration.motion_models import (
    ModelSelection,
    MotionModel,
    Remainder,
    composed,
    largest_saving,
    selected_model,
    turned_by,
    upright,
)
from napari_elsplus.processing.tracking.registration.pair_registration import PreparedFrame, Registrar, Turn
from napari_elsplus.simulation.specimen.trajectories import HandHeld, Spiral, Still, Turning
from recordings import grid_target
from simulated import INSTRUMENT, followed

GRID = Grid(120, 1, (0, 0), (59.3, 59.8), 116.0, RollingShutter(150.0))
LOOSE = 0.02
SIGMA = 3e-4


def texture(seed: int = 0, side: int = 400) -> np.ndarray:
    image = cv2.GaussianBlur(np.random.default_rng(seed).normal(size=(side, side)), (0, 0), 3.0)
    return (100 + 40 * image / image.std()).astype(np.float32)


def view(
    form: np.ndarray, shift: tuple[float, float], registrar: Registrar, noise: float, seed: int,
    tissue: np.ndarray | None = None,
) -> PreparedFrame:  # fmt: skip
    """What a probe at `shift` sees whose pixels lie at `form` times theirs in the scene."""
    tissue = texture() if tissue is None else tissue
    row, col = (np.arange(GRID.side)[:, None] - GRID.centre[0], np.arange(GRID.side) - GRID.centre[1])
    rows = form[0, 0] * row + form[0, 1] * col + 200 + shift[0]
    cols = form[1, 0] * row + form[1, 1] * col + 200 + shift[1]
    seen = registrar.view()
    cv2.remap(tissue, cols.astype(np.float32), rows.astype(np.float32), cv2.INTER_CUBIC, dst=seen.image)
    seen.image[:] += np.random.default_rng(seed).normal(0, noise, seen.image.shape)
    return registrar.prepare(seen)


def pair(form: np.ndarray, shift: tuple[float, float], seed: int = 0) -> tuple[Registrar, PreparedFrame, PreparedFrame]:
    registrar = Registrar(GRID)
    upright_view = view(np.eye(2), (0.0, 0.0), registrar, 2.0, 2 * seed)
    return registrar, upright_view, view(form, shift, registrar, 2.0, 2 * seed + 1)


@pytest.mark.parametrize("degrees", [0.3, -0.2, 0.0])
def test_small_turns_are_told_by_what_a_link_leaves(degrees: float) -> None:
    registrar, a, b = pair(turned_by(np.deg2rad(degrees)), (5.0, -3.0))
    link = registrar.register(a, b, about(GRID.shutter, Warp(b=-5.0, d=3.0)))
    found = registrar.remainder(a, b, link.warp, LOOSE)
    assert found is not None
    _, angle = composed(link.warp, found.step)
    assert abs(angle + np.deg2rad(degrees)) < 4 * found.sigma < np.deg2rad(0.25)


@pytest.mark.parametrize("gain", [0.4, 2.5])
def test_turns_are_found_to_scale_whatever_the_gain_between_the_frames(gain: float) -> None:
    turn = np.deg2rad(0.3)
    registrar, a, b = pair(turned_by(turn), (5.0, -3.0))
    b.image[:] *= gain
    registrar.prepare(b)
    link = registrar.register(a, b, about(GRID.shutter, Warp(b=-5.0, d=3.0)))
    found = registrar.remainder(a, b, link.warp, LOOSE)
    assert found is not None
    _, angle = composed(link.warp, found.step)
    assert angle == pytest.approx(-turn, rel=0.1)


def test_its_uncertainty_is_honest() -> None:
    misses = []
    for seed in range(20):
        registrar, a, b = pair(np.eye(2), (4.0, 2.0), seed)
        link = registrar.register(a, b, about(GRID.shutter, Warp(b=-4.0, d=-2.0)))
        found = registrar.remainder(a, b, link.warp, LOOSE)
        assert found is not None
        misses.append(found.step[-1] / found.sigma)
    assert 0.1 < np.sqrt(np.mean(np.square(misses))) < 1.5


@pytest.mark.parametrize("degrees", [-8.0, 4.0, 10.0])
def test_links_hold_under_large_turns_that_are_roughly_known(degrees: float) -> None:
    turn = np.deg2rad(degrees)
    registrar, a, b = pair(turned_by(turn), (8.0, 6.0))
    moved = turned_by(-turn) @ (8.0, 6.0)
    motion = about(GRID.shutter, Warp())._replace(displacement=Displacement(float(moved[0]) + 1, float(moved[1]) - 1))
    link = registrar.register(a, b, motion, turn=Turn(0.8 * turn))
    assert link is not None
    assert link.observed
    assert abs(np.rad2deg(link.turn) - degrees) < 0.1
    assert np.hypot(-link.warp.b - moved[0], -link.warp.d - moved[1]) < 0.15


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("defects", [0.0, 0.06])
def test_a_grid_that_turned_is_found_where_it_is_or_not_at_all(defects: float, seed: int) -> None:
    """The highest peak of the search is a period away; where lines are alike none is more likely than others."""
    turn, shift, registrar = np.deg2rad(3.0), (1.0, 10.4), Registrar(GRID)
    tissue = 100 * grid_target(400, 13.3, defects, seed)
    a = view(np.eye(2), (0.0, 0.0), registrar, 2.0, 2 * seed, tissue)
    b = view(turned_by(turn), shift, registrar, 2.0, 2 * seed + 1, tissue)
    link = registrar.register(a, b, about(GRID.shutter, Warp()), anywhere=True, turn=Turn(turn))
    assert link is not None
    assert link.observed == (defects > 0)
    moved = turned_by(-turn) @ shift
    assert not link.observed or np.hypot(-link.warp.b - moved[0], -link.warp.d - moved[1]) < 0.3


def test_motion_of_the_earlier_frame_is_undone_before_it_is_turned() -> None:
    """The link's warp is the one that frames of one orientation would have had: it tells both velocities."""
    registrar, a, b = pair(turned_by(np.deg2rad(5.0)), (0.0, 0.0))
    velocity = Velocity(9.0, -6.0)
    r = GRID.shutter.line_periods_per_frame
    sheared = np.array([[1 + velocity.row / r, 0.0], [velocity.col / r, 1.0]])
    upright(a.image.copy(), a.image, GRID.centre, np.linalg.inv(sheared))
    registrar.prepare(a)
    motion = about(GRID.shutter, Warp())._replace(before=velocity)
    link = registrar.register(a, b, motion, turn=Turn(np.deg2rad(4.5)))
    assert link is not None
    expected = GRID.shutter.warp(velocity, Velocity(0.0, 0.0), Displacement(0.0, 0.0))
    assert abs(link.warp.a - expected.a) < 2e-3
    assert abs(link.warp.s - expected.s) < 2e-3
    assert abs(np.rad2deg(link.turn) - 5.0) < 0.1


def test_the_rotation_within_frames_is_not_taken_for_a_part_of_that_between_them() -> None:
    """Rows are read while the probe rotates; between shifted frames that adds as much as shift over rows: 16 %."""
    turn, shift, registrar = np.deg2rad(1.2), (24.0, -18.0), Registrar(GRID)
    row, col = (np.arange(GRID.side)[:, None] - GRID.centre[0], np.arange(GRID.side) - GRID.centre[1])
    views = []
    for angle, (down, across) in ((0.0, (0.0, 0.0)), (turn, shift)):
        at = angle + turn * row / GRID.shutter.line_periods_per_frame
        rows = np.cos(at) * row - np.sin(at) * col + 200 + down
        cols = np.sin(at) * row + np.cos(at) * col + 200 + across
        views.append(seen := registrar.view())
        cv2.remap(texture(), cols.astype(np.float32), rows.astype(np.float32), cv2.INTER_CUBIC, dst=seen.image)
        registrar.prepare(seen)
    moved = turned_by(-turn) @ shift
    motion = about(GRID.shutter, Warp())._replace(displacement=Displacement(*moved.tolist()))
    links = [registrar.register(*views, motion, turn=Turn(turn, frames_apart=apart)) for apart in (1, np.inf)]
    assert all(link is not None and link.observed for link in links)
    errors = [link.turn / turn - 1 for link in links if link is not None]
    assert abs(errors[0]) < 0.03 < 0.1 < abs(errors[1])


def turning(angle: float, control: float = 0.0) -> Remainder:
    """The score test of a registration that shows an angle, and a stretch of so many standard deviations."""
    return Remainder(np.array([0.0, 0.0, 0.0, 0.0, angle]), SIGMA, 1500.0, control)


def noisy(random: np.random.Generator, angle: float = 0.0) -> Remainder:
    """The score test of a registration of frames with noise alone, between which the probe turned by an angle."""
    turn, control = random.normal(size=2)
    return turning(angle + SIGMA * turn, control)


def noticed(rate: float, links: int, seed: int = 0) -> tuple[MotionModel, int]:
    """What a sequence of links asks for, each of which turns a little; and after how many."""
    random = np.random.default_rng(seed)
    selection = ModelSelection()
    for k in range(links):
        if selection.weigh(noisy(random, rate)) is not MotionModel.TRANSLATION:
            return selection.model, k
    return selection.model, links


def test_no_more_is_modelled_than_the_frames_ask_for() -> None:
    assert [noticed(0.0, 500, seed)[0] for seed in range(100)].count(MotionModel.TRANSLATION) >= 99


def test_a_turn_that_no_single_link_shows_is_noticed_in_their_sum() -> None:
    model, links = noticed(2e-4, 500)
    assert model is MotionModel.RIGID
    assert 5 < links < 100


def test_a_turn_that_begins_late_is_noticed() -> None:
    selection, random = ModelSelection(), np.random.default_rng(0)
    models = [selection.weigh(noisy(random, 0.002 if k >= 40 else 0.0)) for k in range(48)]
    assert models[39] is MotionModel.TRANSLATION
    assert models[-1] is MotionModel.RIGID


@pytest.mark.parametrize("links", [1, 2, 5, 20, 63, 200])
def test_a_sudden_turn_is_noticed_at_once_whatever_was_found_before(links: int) -> None:
    """By hand a keyframe serves many frames: of their tests only the newest counts beside those kept before."""
    selection, random = ModelSelection(), np.random.default_rng(0)
    before = {selection.weigh(noisy(random)) for _ in range(links)}
    assert before == {MotionModel.TRANSLATION}
    assert selection.weigh(turning(12 * SIGMA), keep=False) is MotionModel.RIGID


def test_errors_that_mislead_many_links_in_a_row_are_no_turn() -> None:
    """Errors that wander put out the control as well: the sum grows like a turn's, but no faster than that expects."""
    climbed = 0
    for seed in range(40):
        random = np.random.default_rng(seed)
        selection, errors = ModelSelection(), np.zeros(2)
        for _ in range(60):
            errors = 0.6 * errors + 0.8 * random.normal(0, SIGMA, 2)
            selection.weigh(turning(errors[0], errors[1] / SIGMA))
        climbed += selection.model is not MotionModel.TRANSLATION
    assert climbed <= 2


def test_deforming_tissue_that_turns_to_and_fro_is_no_rotation_of_the_probe() -> None:
    """Each finds an angle of three times its uncertainty, and a stretch; the first few may be taken for a rotation."""
    climbed = 0
    for seed in range(40):
        random = np.random.default_rng(seed)
        selection = ModelSelection()
        for _ in range(60):
            turn, stretch = random.normal(0, 3, 2)
            selection.weigh(turning(turn * SIGMA, stretch))
        climbed += selection.model is not MotionModel.TRANSLATION
    assert climbed <= 10


def test_a_probe_that_turns_to_and_fro_turns() -> None:
    """Its rates are of either sign and alike from one to the next, as errors may be, which the control then shows."""
    random, rates = np.random.default_rng(0), 2.5 * SIGMA * np.sin(np.arange(88) / 9)
    found = [noisy(random, rate) for rate in rates]
    assert selected_model(found) is MotionModel.RIGID
    deformed = [one._replace(control=one.control + 2.5 * np.cos(k / 9)) for k, one in enumerate(found)]
    assert selected_model(deformed) is MotionModel.TRANSLATION


@pytest.mark.parametrize(("stretch", "least"), [(0.0, 0.0), (0.004, 5.0), (-0.004, 5.0)])
def test_a_stretch_of_the_columns_shows_in_the_control_alone(stretch: float, least: float) -> None:
    registrar, a, b = pair(np.diag([1.0, 1 + stretch]), (5.0, -3.0))
    link = registrar.register(a, b, about(GRID.shutter, Warp(b=-5.0, d=3.0)))
    assert link is not None
    found = registrar.remainder(a, b, link.warp, LOOSE)
    assert found is not None
    assert least <= abs(found.control) < least + 10
    assert abs(found.step[-1]) < 3 * found.sigma


@pytest.mark.parametrize(
    ("path", "name"),
    [(Turning(Spiral(8000.0), 50.0), "fibres"), (Turning(Still(), -60.0), "nuclei")],
    ids=["fast and turning", "turning in place"],
)
def test_a_probe_that_turns_is_followed(path: Turning, name: str) -> None:
    pipeline, times, place = seen = followed(path, name, 40)
    angle = path.angles_rad(times)
    assert {row.state for row in pipeline.rows} == {"tracked"}
    found = np.array([pose.angle for pose in pipeline.poses])
    assert np.abs(np.rad2deg(found - (angle - angle[0]))).max() < 0.3
    assert np.abs(seen.found_px - (place - place[0]) @ turned_by(-angle[0]).T).max() < 1.0


@dataclass(frozen=True)
class SetsIn:
    """A rotation that sets in, at once, while a frame is read."""

    turning: Turning
    time_s: float

    def positions_um(self, times_s: np.ndarray) -> np.ndarray:
        return self.turning.positions_um(times_s)

    def angles_rad(self, times_s: np.ndarray) -> np.ndarray:
        return self.turning.angles_rad(np.clip(times_s - self.time_s, 0.0, None))


def stepwise(path: Turning | SetsIn, name: str, frames: int) -> tuple[np.ndarray, np.ndarray]:
    """Errors of the displacements between successive frames, all tracked in one segment, and what they state; px."""
    pipeline, times, place = seen = followed(path, name, frames)
    assert {(row.state, row.segment) for row in pipeline.rows} == {("tracked", 0)}
    moved = np.diff((place - place[0]) @ turned_by(-path.angles_rad(times)[0]).T, axis=0)
    return np.hypot(*(np.diff(seen.found_px, axis=0) - moved).T), np.array([row.sigma_px for row in pipeline.rows[1:]])


def test_displacements_of_a_probe_that_turns_are_as_exact_as_stated() -> None:
    """The rotation is estimated at half resolution: what that makes of the shift is less exact than the shift was."""
    error, stated = stepwise(Turning(HandHeld(1500.0, seed=2), 10.0), "fibres", 40)
    assert np.median(error) < 0.045
    assert np.sqrt(np.mean((error / stated) ** 2)) < 0.7


@pytest.mark.parametrize(("degrees", "largest_px"), [(3.0, 0.15), (-5.0, 0.25)])
def test_a_probe_that_turns_by_degrees_a_frame_is_one_segment(degrees: float, largest_px: float) -> None:
    """Without rotation the second frame hardly fits the first one, and no third one."""
    error, stated = stepwise(Turning(HandHeld(1500.0, seed=2), degrees * INSTRUMENT.optics.frame_rate_hz), "nuclei", 16)
    assert error.max() < largest_px
    assert np.sqrt(np.mean((error / stated) ** 2) / 2) < 1.0  # of each axis


def test_a_rotation_that_sets_in_within_a_frame_shows_in_the_uncertainty() -> None:
    """Rows of that frame are displaced by a turn that those of the frame before have not."""
    turning = Turning(HandHeld(1500.0, seed=2), 2.0 * INSTRUMENT.optics.frame_rate_hz)
    error, stated = stepwise(SetsIn(turning, 12.0 * INSTRUMENT.optics.frame_period_s), "nuclei", 24)
    assert error.argmax() == stated.argmax() == 11
    assert error[11] > 0.1
    assert stated[11] > 3 * np.median(stated)
    assert (error / stated)[8:].max() < 3


def test_a_probe_whose_rotation_sets_in_fast_is_found_again() -> None:
    """Its frames are hardly more alike than unrelated ones, which end at half resolution."""
    turning = Turning(HandHeld(1500.0, seed=2), 4.0 * INSTRUMENT.optics.frame_rate_hz)
    pipeline, _, _ = followed(SetsIn(turning, 12.3 * INSTRUMENT.optics.frame_period_s), "nuclei", 30)
    assert sum(row.state == "tracked" for row in pipeline.rows) > 15


def test_a_probe_that_does_not_turn_is_tracked_as_before() -> None:
    pipeline, _, _ = followed(HandHeld(3000.0, seed=2), "fibres", 30)
    assert {pose.angle for pose in pipeline.poses} == {0.0}


def test_a_few_full_views_tell_a_steady_turn_among_many_that_tell_nothing() -> None:
    """Also where the errors of successive links are alike; and what scatters about nothing does not."""
    rng = np.random.default_rng(3)
    sigmas = np.where(np.arange(60) % 6 == 0, 3e-4, 2e-3)
    noise = sigmas * np.convolve(rng.normal(size=61), [0.8, 0.6], "valid")
    values = np.full(60, 1500.0)
    turned, still = (
        np.log(values.sum()) * largest_saving(np.stack([turns, sigmas, values, noise / sigmas]), False)
        for turns in (noise + 7e-4, noise)
    )
    assert turned > 24 > 10 > still
