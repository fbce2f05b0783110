"""Model selection for the motion between two frames: translation, steady motion, all four parameters of the warp.

All answers are displacements of the probe from middle row to middle row, as a track needs them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import cv2
import numpy as np

from benchmarks.harness.methods import Benchmark, Case, Chart, Judgement, Method, Role
from benchmarks.rigs.simulated import simulated_rig, tissue
from napari_elsplus.errors import MeasurementError
from napari_elsplus.processing.tracking.front_end.grid import Grid
from napari_elsplus.processing.tracking.motion.motion_prior import MotionPrior
from napari_elsplus.processing.tracking.motion.rolling_shutter import Displacement, Velocity, Warp
from napari_elsplus.processing.tracking.registration.pair_registration import PairRegistration, Registrar
from napari_elsplus.simulation.specimen.trajectories import Straight, Trajectory, trajectory

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Image = NDArray[np.float32]

WRONG_PX = 1.0
_RIGID_PX, _FREE_PX, _SHIFT_PX = 1e-7, 6.0, 8.0


class Step(NamedTuple):
    """Two successive images of a moving probe, its displacement, and the velocity it had before (grid pixels)."""

    earlier: Image
    later: Image
    moved: NDArray[np.float64]
    velocity: Velocity


def _steps(path: Trajectory, count: int, grid: Grid) -> list[Step]:
    rig = simulated_rig()
    images = rig.tracking_images(rig.recording(tissue("fibres", 2), path, count + 1))
    px = rig.positions_px(path, count + 2) / grid.binning
    return [
        Step(images[k], images[k + 1], px[k + 1] - px[k], Velocity(*(px[k + 1] - px[k]).tolist())) for k in range(count)
    ]


def _cases(quick: bool) -> list[Case]:
    rig = simulated_rig()
    grid = Grid.of(rig.calibration)
    um_s = grid.binning * rig.um_per_px * rig.instrument.optics.frame_rate_hz
    paths: dict[str, Trajectory] = {
        "1 px a frame": Straight(um_s, 50),
        "10 px a frame": Straight(10 * um_s, 50),
        "30 px a frame": Straight(30 * um_s, 50),
        "by hand, 5 px a frame, tremor": trajectory("hand", speed_um_s=5 * um_s, seed=1),
    }
    names = ["10 px a frame"] if quick else list(paths)
    return [Case(name, _steps(paths[name], 2 if quick else 12, grid), context=grid) for name in names]


def judge(item: Step, answer: tuple[float, float]) -> Judgement:
    """Distance from the true displacement."""
    error = float(np.hypot(*np.subtract(answer, item.moved)))
    return Judgement(error, failed=not error <= WRONG_PX)


class _Linked:
    """The registrar, started at the true displacement, with some of the warp's parameters held."""

    def __init__(self, case: Case, *, rigid: bool) -> None:
        self._registrar, self._grid, self._rigid = Registrar(case.context), case.context, rigid
        self._earlier, self._later = self._registrar.view(), self._registrar.view()

    def _link(self, item: Step) -> PairRegistration:
        self._earlier.image[:], self._later.image[:] = item.earlier, item.later
        views = self._registrar.prepare(self._earlier), self._registrar.prepare(self._later)
        v, shutter = item.velocity, self._grid.shutter
        steady = shutter.warp(v, v, shutter.step(v, v))
        if self._rigid:
            at_rest, shift = Velocity(0.0, 0.0), Displacement(-steady.b, -steady.d)
            motion = MotionPrior.between((at_rest, at_rest), shift, (_RIGID_PX, _RIGID_PX), _SHIFT_PX, shutter)
        else:
            motion = MotionPrior.between((v, v), shutter.step(v, v), (_FREE_PX, _FREE_PX), _SHIFT_PX, shutter)
        link = self._registrar.register(*views, motion)
        assert link is not None
        return link

    def uncorrected(self, item: Step) -> tuple[float, float]:
        warp = self._link(item).warp
        return -warp.b, -warp.d

    def steady(self, item: Step) -> tuple[float, float]:
        warp = self._link(item).warp
        periods = 1 + warp.b / self._grid.shutter.line_periods_per_frame  # from middle row to middle row of the content
        return -warp.b / periods, -warp.d / periods

    def four(self, item: Step) -> tuple[float, float]:
        warp, shutter = self._link(item).warp, self._grid.shutter
        row, col = shutter.step(*shutter.velocities(warp))
        return row, col


def _affine(case: Case) -> Callable[[Step], tuple[float, float]]:
    """Prepare OpenCV's affine ECC, six parameters, of which the four that a rolling shutter explains are used."""
    grid: Grid = case.context
    middle = np.array([grid.centre[1], grid.centre[0]])
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 50, 1e-5)

    def align(item: Step) -> tuple[float, float]:
        v = item.velocity
        steady = grid.shutter.warp(v, v, grid.shutter.step(v, v))
        start = np.array([[1, 0, steady.d], [0, 1, steady.b]], np.float32)
        try:
            _, found = cv2.findTransformECC(item.earlier, item.later, start, cv2.MOTION_AFFINE, criteria)
        except cv2.error as error:
            raise MeasurementError(f"ECC: {error.err}", "start nearer") from None
        matrix = np.asarray(found, np.float64)
        shift = matrix[:, :2] @ middle + matrix[:, 2] - middle
        warp = Warp(a=matrix[1, 1], b=shift[1], s=matrix[0, 1], d=shift[0])
        row, col = grid.shutter.step(*grid.shutter.velocities(warp))
        return row, col

    return align


METHODS = (
    Method("translation", Role.PAPER, lambda case: _Linked(case, rigid=True).uncorrected, 2),
    Method("translation, steady motion undone", Role.OPTION, lambda case: _Linked(case, rigid=True).steady, 2),
    Method("rolling-shutter warp", Role.DEFAULT, lambda case: _Linked(case, rigid=False).four, 4),
    Method("OpenCV ECC, affine", Role.PEER, _affine, 6),
)

BENCHMARK = Benchmark(
    name="motion",
    question="How much motion to model between two frames",
    error_label="error of the displacement / px",
    cases=_cases,
    methods=METHODS,
    judge=judge,
    chart=Chart.PARSIMONY,
    remarks=(
        "Pixels are those of the tracking grid. All start at the true displacement: this compares models, not searches."
    ),
)
