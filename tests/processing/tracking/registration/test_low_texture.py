from __future__ import annotations

import cv2
import numpy as np
import pytest

from napari_elsplus.processing.tracking.front_end.front_end import FrontEnd
from napari_elsplus.processing.tracking.motion.rolling_shutter import Displacement, RollingShutter, Velocity, Warp
from napari_elsplus.processing.tracking.motion.warp_prior import WarpPrior, velocity_sigma, warp_prior
from napari_elsplus.processing.tracking.registration.evidence import weakest_direction
from napari_elsplus.processing.tracking.registration.local_evidence import (
    LEAST_EVERYWHERE,
    LEAST_NATS,
    MOST_UNSURE_PX,
    unlikelihood,
)
from napari_elsplus.processing.tracking.registration.local_noise import blocks, local_evidence, shared_information
from napari_elsplus.processing.tracking.registration.low_texture import LowTextureFallback
from napari_elsplus.processing.tracking.registration.lucas_kanade import Workspace
from napari_elsplus.processing.tracking.registration.pair_registration import PairRegistration, PreparedFrame, Registrar
from recordings import record, texture

BEFORE, AFTER = Velocity(9.0, -6.0), Velocity(12.0, -4.0)


def looked_at(
    scene: np.ndarray, **options: float
) -> tuple[Registrar, tuple[PreparedFrame, PreparedFrame], Displacement]:
    """Two successive frames of an accelerating probe, and its displacement."""
    start = np.array(scene.shape) / 2
    truth = record(scene, np.stack([start, start + BEFORE, start + np.add(BEFORE, AFTER)]), **options)  # type: ignore[arg-type]
    front_end = FrontEnd(truth.calibration, truth.frames.shape[1:])
    registrar = Registrar(front_end.grid)
    views = []
    for frame in truth.frames:
        view = registrar.view()
        front_end.image(frame, view.image)
        views.append(registrar.prepare(view))
    return registrar, (views[0], views[1]), front_end.grid.shutter.step(BEFORE, AFTER)


def one_fibre(side: int, end: tuple[float, float] | None) -> np.ndarray:
    """A fibre across the whole scene, or up to an end (row, col) from its centre."""
    image = np.zeros((side, side), np.float32)
    centre = side / 2
    far = (-0.8 * side, -0.48 * side)
    row, col = end or (0.8 * side, 0.48 * side)
    if end is not None:
        far = (row + far[0], col + far[1])
    points = [tuple(int(16 * (centre + v)) for v in (x, y)) for y, x in (far, (row, col))]
    cv2.line(image, points[0], points[1], 1.0, 4, cv2.LINE_AA, 4)
    return cv2.GaussianBlur(image, (0, 0), 1.0)


def known(registrar: Registrar, off: tuple[float, float], trust_px: float | None = 0.3) -> WarpPrior:
    """What the motion tells if the later velocity is taken for something else."""
    after = Velocity(AFTER.row + 2 * off[0], AFTER.col + 2 * off[1])
    shutter = registrar.grid.shutter
    return warp_prior(shutter, (BEFORE, after), shutter.step(BEFORE, after), 3.0, trust_px)


@pytest.mark.parametrize("off", [(0.0, 0.0), (3.0, 2.0), (-2.0, 3.0)])
def test_the_end_of_one_fibre_is_enough(off: tuple[float, float]) -> None:
    registrar, pair, moved = looked_at(one_fibre(900, (40.0, 24.0)))
    link = LowTextureFallback(registrar).link(*pair, known(registrar, off))
    assert link is not None
    found = registrar.grid.shutter.displacement(link.warp, AFTER)
    assert np.hypot(*np.subtract(found, moved)) < 0.5
    assert link.observed


@pytest.mark.parametrize("off", [(0.0, 0.0), (3.0, 2.0), (5.0, 3.0)])
def test_a_fibre_without_ends_does_not_tell_the_motion_along_it(off: tuple[float, float]) -> None:
    registrar, pair, _ = looked_at(one_fibre(900, None))
    second = LowTextureFallback(registrar)
    for link in (second.link(*pair, known(registrar, off)), second.search(*pair, known(registrar, off), 8.0)):
        assert link is None or not link.observed


def test_the_end_is_found_among_all_shifts() -> None:
    registrar, pair, moved = looked_at(one_fibre(900, (40.0, 24.0)))
    link = LowTextureFallback(registrar).search(*pair, known(registrar, (12.0, -9.0)), 16.0)
    assert link is not None
    assert np.hypot(*np.subtract(registrar.grid.shutter.displacement(link.warp, AFTER), moved)) < 0.5


def test_where_everything_is_smooth_there_is_nothing_to_look_at_again() -> None:
    registrar, pair, _ = looked_at(texture(900, 2, 40.0))
    assert LowTextureFallback(registrar).link(*pair, known(registrar, (0.0, 0.0))) is None


def test_a_view_that_is_filled_anew_is_looked_at_anew() -> None:
    registrar, pair, _ = looked_at(one_fibre(900, (40.0, 24.0)))
    second = LowTextureFallback(registrar)
    before = second.link(*pair, known(registrar, (0.0, 0.0)))
    pair[1].image[:] = 0
    registrar.prepare(pair[1])
    after = second.link(*pair, known(registrar, (0.0, 0.0)))
    assert before is not None
    assert after is None or not after.observed


def test_evidence_counts_where_the_frames_differ_however_small_the_place() -> None:
    """A faint dot moves, a bright field does not: the dot alone tells its warp from rest."""
    rng = np.random.default_rng(0)
    side = 96
    first, last = np.full(side, 1, np.int32), np.full(side, side - 1, np.int32)
    frames = []
    for shift in (0, 3):
        image = np.zeros((side, side), np.float32)
        image[10:14] = 100.0  # the same wherever it is shifted along its rows
        image[60:64, 40 + shift : 44 + shift] = 25.0
        frames.append(image + rng.normal(0, 0.2, image.shape).astype(np.float32))
    moved, still = np.array([1.0, 0.0, 0.0, 3.0]), np.array([1.0, 0.0, 0.0, 0.0])
    sums = blocks(2 * side)
    forth = local_evidence(frames[0], frames[1], first, last, 48.0, moved, still, sums)
    back = local_evidence(frames[0], frames[1], first, last, 48.0, still, moved, sums)
    assert np.all(np.divide(forth, (LEAST_NATS, LEAST_EVERYWHERE)) > 1)
    assert np.all(np.divide(back, (LEAST_NATS, LEAST_EVERYWHERE)) < -1)
    assert local_evidence(frames[0], frames[1], first, last, 48.0, moved, moved, sums) == (0, 0)


def test_what_speaks_against_a_warp_is_a_stretch_that_its_shift_does_not_ask_for() -> None:
    registrar, _, _ = looked_at(texture(900, 2))
    prior = known(registrar, (0.0, 0.0))
    expected = np.array(prior.expected)
    follows = np.array(prior.slopes)
    slid = expected + np.array([0.0, 5.0, 0.0, -4.0])
    asked = slid + np.array([5.0 * follows[0], 0.0, -4.0 * follows[1], 0.0])
    assert unlikelihood(expected, expected, prior.terms) == 0
    assert unlikelihood(asked, expected, prior.terms) == pytest.approx(0, abs=1e-9)
    assert unlikelihood(slid, expected, prior.terms) > 1


def test_noise_along_a_fibre_is_no_structure() -> None:
    """Both frames show a fibre from rim to rim: what is known along it comes from what is known beforehand alone."""
    rng = np.random.default_rng(2)
    side = 96
    first, last = np.full(side, 1, np.int32), np.full(side, side - 1, np.int32)
    fibre = np.zeros((side, side), np.float32)
    fibre[46:50] = 40.0
    ended = fibre.copy()
    ended[:, 60:] = 0.0
    here, stiff, information = np.array([1.0, 0.0, 0.0, 0.0]), np.diag([1e6, 1e-4, 1e6, 1e-4]), np.empty((4, 4))
    sigmas = []
    for scene in (fibre, ended):
        noisy = (scene + rng.normal(0, 2.0, (2, side, side))).astype(np.float32)
        earlier, later = (cv2.GaussianBlur(frame, (0, 0), 1.0) for frame in noisy)
        sums, work = blocks(2 * side), Workspace.of(2 * side)
        shared_information(earlier, later, first, last, 48.0, here, stiff, sums, information, work)
        sigmas.append(weakest_direction(information)[0])
    assert sigmas[0] > 2 * MOST_UNSURE_PX
    assert sigmas[1] < MOST_UNSURE_PX


@pytest.mark.parametrize("rows", [280.0, 1120.0])
def test_stretch_and_shear_follow_the_shift(rows: float) -> None:
    """To a tenth of what they change by: the rest is of second order."""
    shutter = RollingShutter(rows)
    expected = warp_prior(shutter, (BEFORE, AFTER), shutter.step(BEFORE, AFTER), 20.0, 0.01)
    after = Velocity(AFTER.row + 6, AFTER.col - 8)
    true = shutter.warp(BEFORE, after, shutter.step(BEFORE, after))
    a, _, s, _ = expected.at(true.b, true.d)
    assert abs(a - true.a) < 0.1 * abs(true.a - expected.expected.a)
    assert abs(s - true.s) < 0.1 * abs(true.s - expected.expected.s)


def test_nothing_follows_a_shift_where_the_velocity_before_is_unknown() -> None:
    for rows, trust in ((280.0, None), (280.0, np.inf), (np.inf, 0.3)):
        shutter = RollingShutter(rows)
        prior = warp_prior(shutter, (BEFORE, AFTER), shutter.step(BEFORE, AFTER), 3.0, trust)
        assert prior.at(5.0, 7.0) == (prior.expected.a, 5.0, prior.expected.s, 7.0)


@pytest.mark.parametrize(("off_px", "refused"), [(0.0, False), (20.0, True)])
def test_a_stretch_far_from_what_is_expected_is_refused(off_px: float, refused: bool) -> None:
    """Where it does not follow from the shift, a warp that needs it has slid."""
    registrar, pair, moved = looked_at(texture(900, 3))
    after = Velocity(AFTER.row + off_px, AFTER.col)
    free = warp_prior(registrar.grid.shutter, (BEFORE, after), moved, 1.0)
    link = LowTextureFallback(registrar).link(*pair, free)
    assert link is not None
    assert link.observed is not refused


def test_misfit_counts_standard_deviations() -> None:
    shutter = RollingShutter(250.0)
    free = warp_prior(shutter, (BEFORE, AFTER), shutter.step(BEFORE, AFTER), 3.0)
    assert free.misfit(free.expected) == 0
    assert free.misfit(free.expected._replace(a=free.expected.a + 6.0 / 250)) == pytest.approx(2.0)


def test_a_velocity_is_as_sure_as_its_link() -> None:
    """Against warps scattered as the information says."""
    rng = np.random.default_rng(1)
    shutter = RollingShutter(280.0)
    root = rng.normal(size=(4, 4)) * [[300.0], [3.0], [300.0], [3.0]]
    information = root @ root.T + np.diag([1e5, 10.0, 1e5, 10.0])
    true = np.array(shutter.warp(BEFORE, AFTER, shutter.step(BEFORE, AFTER)))
    scattered = rng.multivariate_normal(true, np.linalg.inv(information), 4000)
    found = np.array([shutter.velocities(Warp(*warp))[1] for warp in scattered])
    assert velocity_sigma(information, shutter) == pytest.approx(found.std(axis=0).max(), rel=0.2)
    assert velocity_sigma(np.zeros((4, 4)), shutter) == np.inf


@pytest.mark.parametrize(("end", "stands"), [((40.0, 24.0), True), (None, False)])
def test_a_link_that_stood_is_asked_again_where_it_leads(end: tuple[float, float] | None, stands: bool) -> None:
    registrar, pair, moved = looked_at(one_fibre(900, end))
    shutter = registrar.grid.shutter
    slid = Displacement(moved.row + (0.0 if end else 4.3), moved.col + (0.0 if end else 2.6))
    warp = shutter.warp(BEFORE, AFTER, slid)
    link = PairRegistration(warp, np.eye(4), 0.99, 0.9, 0.5)
    second = LowTextureFallback(registrar)
    again = second.confirmed(link, *pair, (BEFORE, AFTER), 0.5, registrar.view())
    assert link.observed
    assert again.observed is stands
    assert again.warp == warp
    sure = link._replace(evidence=2.0)
    assert second.confirmed(sure, *pair, (BEFORE, AFTER), 0.5, registrar.view()) is sure


def test_a_link_between_turned_frames_is_asked_again_upright() -> None:
    registrar, pair, moved = looked_at(texture(900, 3))
    upright = registrar.grid.shutter.warp(Velocity(0.0, 0.0), AFTER, moved)
    right = PairRegistration(upright, np.eye(4), 0.99, 0.9, 0.5, turn=0.0, turn_sigma=1e-3)
    turned = right._replace(turn=0.06)
    velocities, scratch = (BEFORE, AFTER), registrar.view()
    second = LowTextureFallback(registrar)
    seen = [second.confirmed(link, *pair, velocities, 0.5, scratch).again for link in (right, turned)]
    assert seen[0] > 5 * max(seen[1], 1)


def test_soft_light_has_to_say_more_than_detail() -> None:
    registrar, pair, moved = looked_at(texture(900, 2, 40.0))
    warp = registrar.grid.shutter.warp(BEFORE, AFTER, moved)
    for evidence, stands in ((0.2, False), (0.4, True)):
        link = PairRegistration(warp, np.eye(4), 0.95, 0.9, evidence)
        assert link.observed
        again = LowTextureFallback(registrar).confirmed(link, *pair, (BEFORE, AFTER), 0.5, registrar.view())
        assert again.observed is stands
