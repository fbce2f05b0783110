"""Tracking of frames and insertion core by core, and reconstruction of the mosaics of all samples."""

from __future__ import annotations

from functools import lru_cache
from math import hypot
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from scipy.spatial.distance import pdist

from napari_elsplus.errors import InputError
from napari_elsplus.processing.images.sectioning import Frames, Mode
from napari_elsplus.processing.mosaicing.cores.canvas import SampleCanvas
from napari_elsplus.processing.mosaicing.cores.reading import SPOT_PITCHES
from napari_elsplus.processing.mosaicing.cores.reconstruction import (
    canvas_smoothness,
    reconstruct_canvas,
    seen_through,
)
from napari_elsplus.processing.mosaicing.cores.refinement import CoreGains, Placement, refine_placement
from napari_elsplus.processing.mosaicing.mosaic import Insertion
from napari_elsplus.processing.mosaicing.tiles import Rectangle
from napari_elsplus.processing.progress import Progress, without_display
from napari_elsplus.processing.tracking.finished.field import FinishedField
from napari_elsplus.processing.tracking.finished.tracking import FinishedTracking
from napari_elsplus.processing.tracking.front_end.grid import FIELD, Grid
from napari_elsplus.processing.tracking.motion.pose import Pose, TrackingState, tracked_frames
from napari_elsplus.processing.tracking.registration.motion_models import turned_by, unsheared
from napari_elsplus.processing.tracking.registry import Method, tracking_method
from napari_elsplus.workflows.core_mosaicing.fine_pipeline import FinePipeline
from napari_elsplus.workflows.core_mosaicing.views import CoreView, FinishedBundle, view_of_raw_frames
from napari_elsplus.workflows.tracking import INSERTION, Pipeline

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.processing.tracking.methods import TrackingMethod
    from napari_elsplus.workflows.tracking import RawPair

CELLS_PER_PITCH: Final = 4
"""Cells of the mosaic per core pitch; derived: two per period of the finest pattern that the cores' modes pass, half a
pitch."""
MIN_FRAMES: Final = 3
"""Tracked frames of a mosaic; derived: with fewer, the samples are no denser than bars of a core pitch need."""
MIN_TRAVEL_PITCHES: Final = 0.5
"""Distance between the two frames farthest from each other, core pitches; derived: with less, there are parts between
the cores that no frame shows."""
MAX_REFINEMENTS: Final = 8
"""Refinements of finished images; measured on a photographed bundle: three reach 0.05 px with a flat field, six without
one."""
_KEPT_BYTES: Final = 256 << 20
"""Memory for the values of cores between refinements, bytes; chosen: two thousand frames of 32,000 cores."""
_REFINED_PITCHES: Final = 0.02
"""Move of a frame below which the refinement ends, core pitches; chosen, far below a cell."""
_APERTURE: Final = hypot(SPOT_PITCHES * CELLS_PER_PITCH, 12**-0.5)
"""Standard deviation of the Gaussian through which a sample sees the mosaic, cells; derived: the core's mode, and the
rounding of a sample's place to a cell."""
_DIRECTIONS: Final = [(np.sin(angle), np.cos(angle)) for angle in np.arange(16) * np.pi / 8]
"""Unit vectors (row, col) along which the extremes of a path are found; chosen: 16 miss less than 2 % of its extent."""
_MARGIN_CELLS: Final = 8
"""Around the cores of a frame in its part of the mosaic, cells; chosen: seven standard deviations of a core's mode."""


class CorePipeline(Pipeline):
    """Tracks frames and inserts the values of their cores into mosaics finer than the cores.

    Parameters
    ----------
    calibration, frame_shape, mode, method
        As of :class:`Pipeline`.
    view : CoreView
        The image in which the cores are read.
    tracking : TrackingMethod, optional
        As of :class:`Pipeline`.
    max_refinements : int
        How often, at most, the frames' places and brightness and the cores' gains are refined on the mosaics.

    Raises
    ------
    CalibrationError, InputError
        As :class:`Pipeline`.
    """

    inserts_tracked_images = False

    def __init__(
        self,
        calibration: Calibration,
        frame_shape: tuple[int, int],
        mode: Mode | str,
        *,
        view: CoreView,
        method: str = Method.ELSPLUS,
        tracking: TrackingMethod | None = None,
        max_refinements: int = 0,
    ) -> None:
        super().__init__(
            calibration, frame_shape, mode, method=method, insertion=Insertion.CORES, tracking=tracking
        )  # fmt: skip
        self._view, self._max_refinements = view, max_refinements
        self._cell_px = view.cores.pitch_px / CELLS_PER_PITCH
        self._offsets = (view.cores.positions - view.centre) / self.tracking.scale
        at = np.rint(self._offsets + self.grid.centre).astype(int).clip(0, self.grid.side - 1)
        self._at = at[:, 0], at[:, 1]
        within = np.hypot(*self._offsets.T) < 0.5 * FIELD * self.grid.diameter
        self._core_weights = (view.cores.weights * self._weights[self._at] * within).astype(np.float32)
        self._gains = np.ones(len(view.cores), np.float32)
        self._exposures: dict[int, float] = {}
        self._smoothness = 0.0

    @property
    def camera_px_per_pixel(self) -> float:
        """Camera pixels per pixel of the mosaics."""
        return self._cell_px

    def insert_raw(self, pose: Pose, index: int, raw: NDArray[Any], raw_residual: NDArray[Any] | None = None) -> None:
        """Insert the cores of a raw frame at the pose of its `index`; others as of :meth:`Pipeline.add`."""
        values = self._read(raw, raw if raw_residual is None else raw_residual)
        self._insert_cores(pose, self._freed(values))

    def finish(self, raw_pair: RawPair, progress: Progress = without_display) -> None:
        """Refine all positions, insert all frames at them and reconstruct the mosaics: :meth:`Pipeline.finish`.

        Raises
        ------
        InputError
            If too few frames are tracked, or they did not move.
        """
        self.refine(raw_pair, progress)
        tracked = tracked_frames(self.poses)
        self._require_motion([self.poses[k] for k in tracked])
        self._estimate_light(raw_pair)
        kept = _KEPT_BYTES // (4 * len(self._view.cores)) if self._max_refinements else 0
        read = lru_cache(maxsize=kept)(lambda index: self._read(*raw_pair(index)))
        self._insert_all(read, progress(tracked, INSERTION))
        if self._max_refinements:
            self.complete()
        for left in reversed(range(self._max_refinements)):
            moved_px = self._refine_on_mosaics(read, tracked)
            self._insert_all(read, tracked)
            if left == 0 or moved_px < _REFINED_PITCHES * self._view.cores.pitch_px:
                break
            self._reconstruct()
        self.complete()

    def complete(self) -> None:
        """Reconstruct the mosaics from the samples, as smooth as these demand."""
        samples = [canvas for canvas in self.mosaics.values() if isinstance(canvas, SampleCanvas)]
        if samples:
            largest = max(samples, key=lambda canvas: len(list(canvas.extent.tiles())) if canvas.extent else 0)
            self._smoothness = canvas_smoothness(largest, _APERTURE)
        self._reconstruct()

    def _reconstruct(self) -> None:
        for segment, canvas in self.mosaics.items():
            if isinstance(canvas, SampleCanvas):
                self.mosaics[segment] = reconstruct_canvas(canvas, _APERTURE, self._smoothness)

    def _insert_all(self, read: Callable[[int], NDArray[np.float32]], indices: Iterable[int]) -> None:
        """Insert frames, whose cores are read by their index, into fresh mosaics."""
        self.mosaics = {}
        for index in indices:
            self._insert_cores(self.poses[index], self._freed(read(index)), self._exposures.get(index, 1.0))

    def _insert_cores(self, pose: Pose, values: NDArray[np.float32], exposure: float = 1.0) -> None:
        if pose.state is not TrackingState.TRACKED:
            return
        canvas = self.mosaics.setdefault(pose.segment, SampleCanvas(CELLS_PER_PITCH / 2))
        assert isinstance(canvas, SampleCanvas)
        canvas.add(self._places(pose), values / np.float32(exposure), self._core_weights * np.float32(exposure))

    def _read(self, raw: NDArray[Any], raw_residual: NDArray[Any]) -> NDArray[np.float32]:
        """Return the values of the cores (m,) float32 in a frame."""
        return self._view.cores.read(self._view.image(raw, raw_residual))

    def _freed(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return values of the cores (m,) float32 freed of their refined gains and of uneven light."""
        values = values * self._gains
        return values if self._light is None else values / self._light[self._at]

    def _places(self, pose: Pose) -> NDArray[np.float64]:
        """Return the places of the cores (m, 2) on the mosaic, freed of what the rolling shutter did to the frame."""
        line_periods = self.grid.shutter.line_periods_per_frame
        matrix = turned_by(pose.angle) @ unsheared(pose.velocity, line_periods)
        places: NDArray[np.float64] = self._offsets @ matrix.T + (pose.row, pose.col)
        return places * (self.tracking.scale / self._cell_px)

    def _require_motion(self, poses: Sequence[Pose]) -> None:
        needed_px = MIN_TRAVEL_PITCHES * self._view.cores.pitch_px
        if len(poses) < MIN_FRAMES:
            raise InputError(
                f"{len(poses)} tracked frames", f"insertion by cores needs {MIN_FRAMES}, {needed_px:.1f} px apart"
            )
        ends = np.array([(pose.row, pose.col) for pose in poses]) * self.tracking.scale
        extremes = np.concatenate([ends[np.argmin(ends @ way)][None] for way in _DIRECTIONS])
        travel_px = float(pdist(extremes).max())
        if travel_px < needed_px and len({pose.segment for pose in poses}) == 1:
            raise InputError(
                f"the frames lie within {travel_px:.2f} px of each other",
                f"insertion by cores needs {needed_px:.1f} px of motion: move the probe, or choose another insertion",
            )

    def _refine_on_mosaics(self, read: Callable[[int], NDArray[np.float32]], tracked: Sequence[int]) -> float:
        """Refine the frames' places, exposures and the cores' gains on the mosaics that they gave.

        The first frame of a segment stays. Returns the largest move of a frame, camera pixels.
        """
        first: dict[int, Placement] = {}
        farthest = 0.0
        gains, cell = CoreGains(len(self._view.cores)), self._cell_px / self.tracking.scale
        for index in tracked:
            pose, values = self.poses[index], self._freed(read(index))
            places = self._places(pose)
            part = _around(places)
            expected = seen_through(self.mosaics[pose.segment], part, SPOT_PITCHES * CELLS_PER_PITCH)
            at = places - (part.top, part.left)
            found = refine_placement(expected, at, values, self._core_weights, CELLS_PER_PITCH)
            gains.add(expected, np.add(at, (found.row, found.col)), values, found.exposure)
            self._exposures[index] = found.exposure
            origin = first.setdefault(pose.segment, found)
            down, across = found.row - origin.row, found.col - origin.col
            self.poses[index] = pose._replace(row=pose.row + cell * down, col=pose.col + cell * across)
            farthest = max(farthest, self._cell_px * hypot(down, across))
        self._gains = self._gains * gains.corrections(len(tracked))
        self._rewrite_rows()
        return farthest


def new_pipeline(
    calibration: Calibration, frame_shape: tuple[int, int], mode: Mode, method: str, insertion: Insertion | str
) -> Pipeline:
    """Return the pipeline that tracks raw frames of a calibrated rig and inserts them by a rule.

    Parameters
    ----------
    calibration : Calibration
        With its bundle section; insertion by cores needs its flat field, too.
    frame_shape : tuple of int
        Rows and columns of the raw frames.
    mode : Mode
        Image type to track and insert.
    method : str
        Name of the tracking method.
    insertion : Insertion or str
        How overlapping frames are combined.

    Raises
    ------
    CalibrationError
        If the bundle was not located, or does not fit the frames.
    InputError
        If cores are to be inserted that the calibration's flat field does not show.
    """
    if Insertion(insertion) is not Insertion.CORES:
        finer = tracking_method(method).tapers_rim and Grid.of(calibration).binning > 1
        made = FinePipeline if finer else Pipeline
        return made(calibration, frame_shape, mode, method=method, insertion=insertion)
    view = view_of_raw_frames(calibration, frame_shape, mode)
    return CorePipeline(calibration, frame_shape, mode, view=view, method=method)


def new_finished_pipeline(
    frames: Frames,
    calibration: Calibration,
    method: str,
    insertion: Insertion | str,
    *,
    flat: NDArray[Any] | None = None,
) -> Pipeline:
    """Return the pipeline that tracks finished images and inserts them by a rule.

    Parameters
    ----------
    frames : Frames
        (T, rows, cols).
    calibration : Calibration
        Nominal: :func:`~napari_elsplus.workflows.tracking.calibration_of_finished_images`.
    method : str
        Name of the tracking method. ``"elsplus"`` registers and inserts at the images' own resolution, without a
        rolling shutter; others receive the images as a confocal view. For insertion by cores ``"elsplus"``, since
        others would track the cores.
    insertion : Insertion or str
        How overlapping frames are combined.
    flat : numpy.ndarray, optional
        (rows, cols) evenly lit image of the bundle, in which cores are found; the mean of the frames by default.

    Raises
    ------
    InputError
        If the images are too small to be tracked; if cores are to be inserted that they do not show, or by another
        tracking method.
    """
    rows, cols = frames[0].shape
    if Insertion(insertion) is not Insertion.CORES:
        tracking = FinishedTracking(FinishedField.of_stack(frames)) if method == Method.ELSPLUS else None
        return Pipeline(calibration, (rows, cols), Mode.LS, method=method, insertion=insertion, tracking=tracking)
    if method != Method.ELSPLUS:
        raise InputError(
            f"the method {method!r} would track the cores of finished images", f"choose {Method.ELSPLUS.value!r}"
        )
    bundle, tries = FinishedBundle(frames, flat), MAX_REFINEMENTS
    return CorePipeline(
        calibration, (rows, cols), Mode.LS, view=bundle.view, tracking=bundle.tracking(), max_refinements=tries
    )  # fmt: skip


def _around(places: NDArray[np.float64]) -> Rectangle:
    """Return the rectangle around places (m, 2), with a margin."""
    top, left = (np.floor(places.min(axis=0)).astype(int) - _MARGIN_CELLS).tolist()
    bottom, right = (np.ceil(places.max(axis=0)).astype(int) + _MARGIN_CELLS + 1).tolist()
    return Rectangle(top, left, bottom, right)
