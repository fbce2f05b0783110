"""A stack to a track and the mosaics of several modes along it, which can be looked at while they grow."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import nan
from typing import TYPE_CHECKING, Any, Final, Protocol

import numpy as np

from napari_elsplus.calibration import Calibration
from napari_elsplus.errors import CalibrationError, InputError
from napari_elsplus.pipeline import RawPairs
from napari_elsplus.processing.mosaicing.coverage import coverage_maps
from napari_elsplus.processing.sectioning import Mode
from napari_elsplus.processing.tracking.grid import FIELD
from napari_elsplus.processing.tracking.pose import State
from napari_elsplus.timing import with_timing
from napari_elsplus.tracking_pipeline import UNLINKED, Method, Pipeline
from napari_elsplus.viewing.growing import GrowingImage
from napari_elsplus.viewing.track import fastest_px_per_frame

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from numpy.typing import NDArray

    from napari_elsplus.io import TrackPoint
    from napari_elsplus.mosaic_plan import MosaicPlan
    from napari_elsplus.processing.mosaicing.tiles import Canvas
    from napari_elsplus.processing.sectioning import Frames
    from napari_elsplus.processing.tracking.pose import Pose

    Watch = Callable[[Iterable[int]], Iterable[int]]

_RIM_PX: Final = 4


class Mosaics(Protocol):
    """What is looked at while it grows: a track and mosaics, made here or by a running engine."""

    @property
    def rows(self) -> Sequence[TrackPoint]:
        """The track so far, a row for every frame."""

    @property
    def canvases(self) -> Mapping[Mode, Mapping[int, Canvas]]:
        """The segments of each mode."""

    @property
    def revision(self) -> int:
        """Another number once what was there before has changed."""

    @property
    def scale(self) -> MosaicScale:
        """How large things are."""


@dataclass(frozen=True)
class MosaicScale:
    """How large the pixels of a mosaic are, and how far a frame reaches.

    Attributes
    ----------
    camera_px_per_pixel : float
        Camera pixels per pixel of the mosaic.
    camera_um_per_px : float or None
        Scale of a camera pixel.
    radius_px : float
        Of what is used of a frame, pixels of the mosaic.
    fastest_px : float
        Camera pixels per frame that can be followed.
    """

    camera_px_per_pixel: float
    camera_um_per_px: float | None
    radius_px: float
    fastest_px: float

    @property
    def um_per_px(self) -> float | None:
        """Scale of a pixel of the mosaic."""
        return None if self.camera_um_per_px is None else self.camera_um_per_px * self.camera_px_per_pixel


class StackMosaics:
    """Tracks a stack and lays its frames into mosaics, one for each mode and segment.

    One thread runs it; others may look at :attr:`rows` and :attr:`canvases` meanwhile.

    Parameters
    ----------
    frames : Frames
        (T, rows, cols), raw.
    calibration : Calibration
        Needs the bundle section.
    plan : MosaicPlan
        What is made.
    times_s : sequence of float, optional
        When each frame was taken; from the calibration's timing, where that is known, by default.

    Attributes
    ----------
    notes : list of str
        What the user should be told.

    Raises
    ------
    InputError
        If there are fewer than two frames, they show nothing, or hold NaN.
    CalibrationError
        If the calibration does not fit.
    """

    def __init__(
        self, frames: Frames, calibration: Calibration, plan: MosaicPlan, times_s: Sequence[float] | None = None
    ) -> None:
        self.plan, self.calibration = plan, calibration
        self.notes: list[str] = []
        self.revision = 0
        self._frames = _Checked(frames)
        self._pairs = RawPairs(self._frames, plan.tracked)
        self._frames.look()
        self._times_s = times_s
        self._lead = self._pipeline(plan.tracked)
        self._followers = {mode: self._pipeline(mode) for mode in plan.modes if mode is not plan.tracked}
        self._shown: Mapping[Mode, Mapping[int, Canvas]] | None = None
        self._rows: list[TrackPoint] | None = None

    @property
    def steps(self) -> int:
        """How many steps :meth:`run` goes through at most."""
        return (3 if self._followers else 2) * len(self._pairs)

    @property
    def rows(self) -> Sequence[TrackPoint]:
        """The track so far, a row for every frame."""
        return self._lead.rows if self._rows is None else self._rows

    @property
    def canvases(self) -> Mapping[Mode, Mapping[int, Canvas]]:
        """The segments of each mode, in the order of the plan."""
        if self._shown is not None:
            return self._shown
        makers = {self.plan.tracked: self._lead, **self._followers}
        return {mode: dict(makers[mode].mosaics) for mode in self.plan.modes}

    @property
    def scale(self) -> MosaicScale:
        """How large things are."""
        grid, per_pixel = self._lead.grid, self._lead.camera_px_per_pixel
        return MosaicScale(
            per_pixel,
            self.calibration.um_per_px,
            0.5 * FIELD * grid.diameter,
            fastest_px_per_frame(grid.diameter, per_pixel, self.plan.method),
        )

    def rehearse(self) -> None:
        """Lay two frames and draw them as a viewer does, to no end but that everything is compiled before it looks."""
        pipeline = self._pipeline(self.plan.tracked)
        for index in range(min(2, len(self._pairs))):
            raw, raw_residual = self._pairs(index)
            pipeline.add(raw, index, raw_residual=raw_residual)
        image = GrowingImage()
        image.update(pipeline.mosaics)
        coverage_maps(np.zeros((1, 2)), np.ones(1), self.scale.radius_px, image.frame)

    def run(self, watch: Watch = iter, checkpoint: Callable[[], None] | None = None) -> None:
        """Track and lay all frames, then close loops, join segments, and lay everything where it belongs.

        Parameters
        ----------
        watch : callable
            Goes through numbers, one a step; what it raises ends the run, and what was laid until then stays.
        checkpoint : callable
            Called whenever a frame is read; what it raises ends the run, too.
        """
        self._frames.checkpoint = checkpoint or _go_on
        try:
            self._run(watch)
        finally:
            self._frames.checkpoint = _go_on

    def undo(self) -> bool:
        """Take the last segment away, and call its frames lost; whether there was one."""
        left = without_last_segment(self.canvases, self.rows)
        if left is None:
            return False
        self._shown, self._rows = left
        self.revision += 1
        return True

    def _run(self, watch: Watch) -> None:
        if self.plan.method is Method.ELSPLUS:
            self.calibration, said = with_timing(self.calibration, self._pairs, self.plan.tracked)
            if said:
                self.notes.append(said)
                self._lead = self._pipeline(self.plan.tracked)
                self._followers = {mode: self._pipeline(mode) for mode in self._followers}
        for index in watch(range(len(self._pairs))):
            frame = self._pairs.frame(index)
            raw, raw_residual = self._pairs(index)
            self._lead.add(raw, frame, self._time_s(frame), raw_residual)
            self._follow(self._followers, self._lead.poses[-1], frame)
        self._refine(watch)
        if sum(row.state == State.TRACKED.value for row in self.rows) < 2:
            self.notes.append(UNLINKED)

    def _refine(self, watch: Watch) -> None:
        self._shown, self._rows = self.canvases, list(self._lead.rows)  # stay on screen meanwhile
        self._lead.finish(self._pairs, watch)
        fresh = {mode: self._pipeline(mode) for mode in self._followers}
        if fresh:
            for index in watch(range(len(self._pairs))):
                self._follow(fresh, self._lead.poses[index], self._pairs.frame(index))
        self._followers = fresh
        self._shown = self._rows = None
        self.revision += 1

    def _follow(self, followers: Mapping[Mode, Pipeline], pose: Pose, frame: int) -> None:
        if pose.state is not State.TRACKED:
            return
        for mode, follower in followers.items():
            if mode is not Mode.ELSA:
                follower.lay(pose, self._frames[frame])
            elif frame % 2 == 0 and frame + 1 < len(self._frames):
                follower.lay(pose, self._frames[frame], self._frames[frame + 1])

    def _pipeline(self, mode: Mode) -> Pipeline:
        rows, cols = self._frames[0].shape
        return Pipeline(
            self.calibration, (rows, cols), mode, method=self.plan.method, insertion=self.plan.insertion
        )  # fmt: skip

    def _time_s(self, frame: int) -> float:
        if self._times_s is not None:
            return float(self._times_s[frame])
        period_s = self.calibration.frame_period_s
        return nan if period_s is None else frame * period_s


def without_last_segment(
    canvases: Mapping[Mode, Mapping[int, Canvas]], rows: Sequence[TrackPoint]
) -> tuple[dict[Mode, dict[int, Canvas]], list[TrackPoint]] | None:
    """Return mosaics and track without the last segment, its frames called lost; None if there is no segment."""
    numbers = {number for segments in canvases.values() for number in segments}
    if not numbers:
        return None
    last = max(numbers)
    kept = {
        mode: {number: canvas for number, canvas in segments.items() if number != last}
        for mode, segments in canvases.items()
    }
    return kept, [_lost(row) if row.segment == last else row for row in rows]


def images_as_they_are(frames: Frames, um_per_px: float | None = None) -> Calibration:
    """Make a calibration for finished images of one bundle, whose disc touches the image's edges.

    Raises
    ------
    CalibrationError
        If the images are too small to be tracked.
    """
    rows, cols = frames[0].shape
    diameter = min(rows, cols) - _RIM_PX
    if diameter < 2 * _RIM_PX:
        raise CalibrationError(f"the images have {rows} x {cols} pixels", "choose a stack of larger ones")
    centre = [(rows - 1) / 2, (cols - 1) / 2]
    bundle = {
        "confocal_centre": centre,
        "residual_centre": centre,
        "diameter_px": diameter,
        "residual_to_confocal": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
    }
    return Calibration.parse({"bundle": bundle, **({} if um_per_px is None else {"optics": {"um_per_px": um_per_px}})})


class _Checked:
    """Frames that are refused, with their number, where nothing can be made of them."""

    def __init__(self, frames: Frames) -> None:
        self._frames = frames
        self.checkpoint: Callable[[], None] = _go_on
        if len(frames) < 2:
            raise InputError(
                f"the stack has {len(frames)} frame{'s' * (len(frames) != 1)}", "choose one of at least two"
            )

    def __len__(self) -> int:
        return len(self._frames)

    def __getitem__(self, index: int) -> NDArray[Any]:
        self.checkpoint()
        frame = np.asarray(self._frames[index])
        if frame.ndim != 2:
            raise InputError(f"a frame has shape {frame.shape}", "choose a stack (T, rows, cols) of grey levels")
        if frame.dtype.kind == "f" and not np.isfinite(frame).all():
            raise InputError(f"frame {index} holds NaN or infinity", "mend it, or choose another stack")
        return frame

    def look(self) -> None:
        """Refuse a stack whose frames show nothing."""
        chosen = [self[index] for index in sorted({0, len(self) // 2, len(self) - 1})]
        if all(frame.min() == frame.max() for frame in chosen):
            raise InputError(
                f"the frames are constant (grey level {chosen[0].flat[0]:g})",
                "is the laser on, and the probe on tissue?",
            )


def _go_on() -> None:
    """Let the run go on."""


def _lost(row: TrackPoint) -> TrackPoint:
    return replace(
        row, row_px=nan, col_px=nan, row_um=nan, col_um=nan, score=nan, sigma_px=nan, state=State.LOST.value
    )  # fmt: skip
