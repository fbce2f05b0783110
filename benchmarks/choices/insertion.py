"""Laying frames into a mosaic whose positions are known: what it costs, and how like the tissue the mosaic is."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import cv2
import numpy as np

from benchmarks.harness.agreement import unexplained
from benchmarks.harness.methods import Benchmark, Case, Judgement, Method, Role, TimedElsewhere
from benchmarks.harness.peers import peer
from benchmarks.rigs.simulated import SimulatedRig, simulated_rig
from napari_elsplus.processing.mosaicing.mosaic import STILL, Insertion, Mosaic, rim_weights
from napari_elsplus.processing.tracking.front_end.grid import Grid, lit_pixels
from napari_elsplus.processing.tracking.motion.rolling_shutter import Velocity
from napari_elsplus.simulation.specimen.scenes import scene
from napari_elsplus.simulation.specimen.trajectories import Straight

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from napari_elsplus.simulation.specimen.trajectories import Trajectory

    Image = NDArray[np.float32]

_SMOOTHING_PX = 1.0
_INSIDE_PX = 5


class Stroke(NamedTuple):
    """Tracking images along a path, true positions and velocities on their grid, and the scene."""

    images: list[Image]
    positions: NDArray[np.float64]
    velocities: NDArray[np.float64]
    name: str
    um_per_px: float


class Canvas(NamedTuple):
    """A mosaic, and where its first pixel lies on the grid (row, col)."""

    image: Image
    covered: NDArray[np.bool_]
    top: float
    left: float


def stroke(rig: SimulatedRig, name: str, path: Trajectory, frames: int) -> Stroke:
    """Record a scene along a path and make tracking images of it."""
    binning = Grid.of(rig.calibration).binning
    images = rig.tracking_images(rig.recording(scene(name), path, frames))
    periods = rig.periods_at_middle(frames)
    px = binning * rig.um_per_px
    period_s = rig.instrument.optics.frame_period_s

    def at(k: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(path.positions_um(np.asarray(k * period_s, np.float64)) / px, np.float64)

    return Stroke(images, at(periods), at(periods + 0.5) - at(periods - 0.5), name, px)


def _cases(quick: bool) -> list[Case]:
    rig = simulated_rig()
    frames = 4 if quick else 40
    speeds = (8000.0,) if quick else (8000.0, 500.0)
    grid = Grid.of(rig.calibration)
    offset = rig.instrument.offset_rows / grid.binning
    return [
        Case(f"fibres, {speed / 1000:g} mm/s", [stroke(rig, "fibres", Straight(speed), frames)],
             context=(grid, rim_weights(grid, offset)), calls=frames)
        for speed in speeds
    ]  # fmt: skip


def judge(item: Stroke, answer: Canvas) -> Judgement:
    """Part of the mosaic that the focal plane of the scene does not explain."""
    rows, cols = (
        np.asarray((np.arange(size) + first) * item.um_per_px, np.float64)
        for size, first in zip(answer.image.shape, (answer.top, answer.left), strict=True)
    )
    true = scene(item.name).planes[0].texture.sample(rows, cols)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * _INSIDE_PX + 1,) * 2)
    inside = cv2.erode(answer.covered.astype(np.uint8), disc).astype(bool)
    seen, expected = (cv2.GaussianBlur(image, (0, 0), _SMOOTHING_PX)[inside] for image in (answer.image, true))
    rho = float(np.corrcoef(seen, expected)[0, 1])
    return Judgement(unexplained(seen, expected), details={"correlation": rho})


def _ours(insertion: Insertion, *, unshear: bool = True) -> Callable[[Case], Callable[[Stroke], Canvas]]:
    def prepare(case: Case) -> Callable[[Stroke], Canvas]:
        grid, weights = case.context

        def lay(item: Stroke) -> Canvas:
            mosaic = Mosaic(grid, insertion, weights=weights)
            for image, position, velocity in zip(item.images, item.positions, item.velocities, strict=True):
                row, col = position.tolist()
                mosaic.insert(image, row, col, Velocity(*velocity.tolist()) if unshear else STILL)
            image, weight = mosaic.read()
            assert mosaic.extent is not None
            return Canvas(image, weight > 0, mosaic.extent.top, mosaic.extent.left)

        return lay

    return prepare


def field_mask(grid: Grid) -> NDArray[np.uint8]:
    """Return the 90 % disc of a grid's images, (side, side), 0 or 1."""
    return lit_pixels(*grid.spans()).astype(np.uint8)


def _copied(case: Case) -> Callable[[Stroke], Canvas]:
    grid, _ = case.context
    mask = field_mask(grid)

    def lay(item: Stroke) -> Canvas:
        corner = np.rint(item.positions - np.array(grid.centre)).astype(int)
        first = corner.min(axis=0)
        shape = corner.max(axis=0) - first + grid.side
        canvas, covered = np.zeros(shape, np.float32), np.zeros(shape, np.uint8)
        for image, (row, col) in zip(item.images, corner - first, strict=True):
            here = np.s_[row : row + grid.side, col : col + grid.side]
            cv2.copyTo(image, mask, canvas[here])
            cv2.copyTo(mask, mask, covered[here])
        return Canvas(canvas, covered.astype(bool), float(first[0]), float(first[1]))

    return lay


def _pyfibrebundle(*, blend: bool) -> Callable[[Case], Callable[[Stroke], TimedElsewhere]]:
    def prepare(case: Case) -> Callable[[Stroke], TimedElsewhere]:
        other, (grid, _) = peer("PyFibreBundle"), case.context
        mask = field_mask(grid)

        def lay(item: Stroke) -> TimedElsewhere:
            first = np.floor(item.positions.min(axis=0)) - grid.side
            size = int(np.ceil((item.positions.max(axis=0) - first).max())) + grid.side
            canvas, seconds = other(
                "lay", images=np.stack(item.images), places=np.rint(item.positions - first), mask=mask,
                size=size, crop=0.9 * grid.diameter, blend=blend,
            )  # fmt: skip
            # it puts the middle of an image, side / 2, onto the place; the bundle's centre is a little off that
            top, left = first + grid.side / 2 - np.array(grid.centre)
            return TimedElsewhere(Canvas(canvas.astype(np.float32), canvas != 0, float(top), float(left)), seconds)

        return lay

    return prepare


METHODS = (
    Method("dead leaf, unsheared", Role.DEFAULT, _ours(Insertion.DEAD_LEAF)),
    Method("feathered, unsheared", Role.OPTION, _ours(Insertion.FEATHERED)),
    Method("dead leaf, sheared", Role.OPTION, _ours(Insertion.DEAD_LEAF, unshear=False)),
    Method("dead leaf, whole pixels", Role.PAPER, _copied),
    Method("PyFibreBundle dead leaf", Role.PEER, _pyfibrebundle(blend=False)),
    Method("PyFibreBundle blended", Role.PEER, _pyfibrebundle(blend=True)),
)

BENCHMARK = Benchmark(
    name="insertion",
    question="How a frame is laid into the mosaic",
    error_label="part of the mosaic that the focal plane does not explain",
    cases=_cases,
    methods=METHODS,
    judge=judge,
    remarks="Time for each frame, the canvas's first touch included. Positions are the true ones.",
)
