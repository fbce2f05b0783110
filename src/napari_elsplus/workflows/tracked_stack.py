"""Track and mosaics of a stack, of one image type or several: what the command line and the Mosaic panel run."""

from __future__ import annotations

from functools import cached_property
from math import nan
from typing import TYPE_CHECKING, Any, Final, Literal

from napari_elsplus.errors import InputError
from napari_elsplus.io import TrackTable
from napari_elsplus.io.frame_times import median_period_s
from napari_elsplus.processing.calibration.core_agreement import agreement_note
from napari_elsplus.processing.images.modes import elsa_pair
from napari_elsplus.processing.images.sectioning import Frames, Mode
from napari_elsplus.processing.progress import Progress, without_display
from napari_elsplus.processing.tracking.methods import RegistrationTracking
from napari_elsplus.processing.tracking.motion.pose import TrackingState
from napari_elsplus.processing.tracking.registry import tracking_method
from napari_elsplus.workflows.core_mosaicing.pipeline import new_finished_pipeline, new_pipeline
from napari_elsplus.workflows.sectioning import RawPairs
from napari_elsplus.workflows.tracking import INSERTION, UNLINKED
from napari_elsplus.workflows.two_threads import tracking_images

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import numpy as np
    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.processing.mosaicing.tiles import Canvas
    from napari_elsplus.workflows.mosaic_plan import MosaicPlan
    from napari_elsplus.workflows.tracking import Pipeline

TRACKING: Final = "Tracking"
"""Name of the step in which all frames are tracked."""
MAX_PERIOD_DIFFERENCE: Final = 0.03
"""Tolerated difference of frame periods, fraction. Chosen: the correction of motion within a frame has this relative
error, 0.3 px where the probe moves 10."""
TIMING_FRAMES: Final = 600
"""Frames that are tracked for the estimate at most: 2.5 s at 240 Hz; chosen, its standard deviation is reported."""


class TrackedStack:
    """Tracks the frames of a stack and inserts them into mosaics, one for each image type and segment.

    Parameters
    ----------
    frames : Frames
        (T, rows, cols), raw, or finished images.
    calibration : Calibration
        Contains the bundle section; nominal for finished images.
    plan : MosaicPlan
        Modes, method and insertion.
    times_s : sequence of float, optional
        (T,) acquisition time of each frame, seconds; unknown by default.
    frame_numbers : sequence of int, optional
        (T,) the camera's number of each frame, where gaps are lost frames; none were lost by default.
    finished : bool
        True for finished images, which are tracked at their own resolution; the plan then has one mode, LS.
    flat : numpy.ndarray, optional
        (rows, cols) evenly lit image of the bundle, in which the cores of finished images are found.

    Attributes
    ----------
    calibration : Calibration
        From :meth:`track` on with the line periods per frame, estimated from the motion if it lacked them.
    lead : Pipeline
        Tracks the first of the plan's image types; the others are inserted along its track.
    rows : TrackTable
        Track so far, a row for every frame; another object after loop closure.
    notes : list of str
        Messages for the user.
    revision : int
        Number that changes when existing poses or segments change.
    complete : bool
        True once all frames are tracked and loops closed; never where that was ended before.

    Raises
    ------
    InputError
        If there are too few frames, or times or numbers are not as many.
    CalibrationError
        If the calibration does not fit.
    """

    def __init__(
        self,
        frames: Frames,
        calibration: Calibration,
        plan: MosaicPlan,
        times_s: Sequence[float] | NDArray[np.float64] | None = None,
        frame_numbers: Sequence[int] | NDArray[np.int64] | None = None,
        *,
        finished: bool = False,
        flat: NDArray[Any] | None = None,
    ) -> None:
        for name, values in (("times", times_s), ("frame numbers", frame_numbers)):
            if values is not None and len(values) != len(frames):
                raise InputError(f"{len(values)} {name} for {len(frames)} frames", "give one for each frame")
        self.plan, self.calibration = plan, calibration
        self.rows = TrackTable()
        self.notes: list[str] = []
        self.revision, self.complete = 0, False
        self._frames, self._times_s, self._finished, self._flat = frames, times_s, finished, flat
        self._pairs = RawPairs(frames, plan.tracked, frame_numbers)
        self._followers: dict[Mode, Pipeline] = {}
        self._set_out()
        self._shown: Mapping[Mode, Mapping[int, Canvas]] | None = None

    @property
    def canvases(self) -> Mapping[Mode, Mapping[int, Canvas]]:
        """Segments of each mode, in the order of the plan."""
        if self._shown is not None:
            return self._shown
        makers = {self.plan.tracked: self.lead, **self._followers}
        return {mode: dict(makers[mode].mosaics) for mode in self.plan.modes}

    def run(self, progress: Progress = without_display) -> None:
        """Track and insert all frames, then close loops, join segments, and re-render the mosaics.

        Parameters
        ----------
        progress : Progress
            Wraps the numbers of the frames in each step: tracking, again where that is needed, and insertion. An
            exception raised in it ends the run, and the mosaics so far remain.
        """
        self.track(progress)
        self.finish(progress)

    def track(self, progress: Progress = without_display, *, grow: bool = True, threads: Literal[1, 2] = 1) -> None:
        """Track all frames.

        Parameters
        ----------
        progress : Progress
            As of :meth:`run`.
        grow : bool
            Insert each frame at once, so that the mosaics can be displayed meanwhile, and note it in :attr:`rows`.
        threads : int
            2 to register a frame while the next is sectioned, where mosaics need not grow; the result is the same.
        """
        if not self._finished:
            given = self.calibration
            self.calibration, self.notes = self._timed()
            if self.calibration is not given:
                self._set_out()
        lead, pairs, indices = self.lead, self._pairs, range(len(self._pairs))
        if grow:
            for index in progress(indices, TRACKING):
                raw, raw_residual = pairs(index)
                lead.tracking.skip(pairs.lost_before(index))
                lead.add(raw, pairs.frame(index), self._time_s(index), raw_residual)
                self.rows.append(lead.rows[-1])
                self._follow(index)
            return
        with tracking_images(lead, map(pairs, indices), len(pairs), threads=threads) as images:
            for index, image in zip(progress(indices, TRACKING), images, strict=True):
                lead.tracking.skip(pairs.lost_before(index))
                lead.note(lead.tracking.estimate_pose(image), pairs.frame(index), self._time_s(index))

    def _time_s(self, index: int) -> float:
        """Return the time of an image in seconds; NaN where times are unknown."""
        return nan if self._times_s is None else float(self._times_s[self._pairs.frame(index)])

    def finish(self, progress: Progress = without_display) -> None:
        """Close loops, join segments, and render the mosaics; parameters as of :meth:`run`."""
        self._shown = self.canvases  # displayed until the re-rendered ones are complete
        self.lead.finish(self._pairs, progress)
        self._followers = {mode: self._pipeline(mode) for mode in self._followers}
        for follower in self._followers.values():
            follower.line_light, follower.deformation = self.lead.line_light, self.lead.deformation
            follower.fading = self.lead.fading
        if self._followers:
            for index in progress(range(len(self._pairs)), INSERTION):
                self._follow(index)
        for follower in self._followers.values():
            follower.complete()
        self.rows, self._shown = TrackTable(self.lead.rows), None
        self.revision, self.complete = self.revision + 1, True
        self.notes += self._notes_on_track()

    def refine(self, progress: Progress = without_display) -> None:
        """Close loops and join segments; mosaics are left as they are. Parameters as of :meth:`run`."""
        self.lead.refine(self._pairs, progress)

    def _set_out(self) -> None:
        self.lead = self._pipeline(self.plan.tracked)
        others = [mode for mode in self.plan.modes if mode is not self.plan.tracked]
        self._followers = {mode: self._pipeline(mode) for mode in others}

    def _timed(self) -> tuple[Calibration, list[str]]:
        """Return the calibration with the timing that raw frames are tracked by, and messages to the user."""
        calibration, pairs = self.calibration, self._pairs
        notes = [
            agreement_note(self._frames, calibration), frame_rate_note(calibration, self._times_s, pairs.frame_numbers)
        ]  # fmt: skip
        if tracking_method(self.plan.method).corrects_rolling_shutter:
            calibration, note = with_timing(calibration, pairs, self.plan.tracked)
            notes.append(note)
        return calibration, [note for note in notes if note]

    def _notes_on_track(self) -> list[str]:
        """Return messages to the user: light that was taken out of the mosaics, and too few tracked frames."""
        light, notes = self.lead.line_light, []
        if light is not None and light.uneven:
            low, high = (100 * part for part in light.spread)
            notes.append(f"uneven light of the line, {low:.0f} to {high:.0f} % of its mean, was taken out")
        if sum(row.state == TrackingState.TRACKED for row in self.lead.rows) < 2:
            notes.append(UNLINKED)
        return notes

    def _follow(self, index: int) -> None:
        """Insert a frame into the mosaics of the modes that are not tracked, by its index in the track."""
        pose, frame = self.lead.poses[index], self._pairs.frame(index)
        if pose.state is not TrackingState.TRACKED:
            return
        confocal, residual = elsa_pair(frame)
        for mode, follower in self._followers.items():
            if mode is not Mode.ELSA:
                follower.insert_raw(pose, index, self._frames[frame])
            elif frame == confocal and residual < len(self._frames):
                follower.insert_raw(pose, index, self._frames[confocal], self._frames[residual])

    def _pipeline(self, mode: Mode) -> Pipeline:
        if self._finished:
            return new_finished_pipeline(
                self._frames, self.calibration, self.plan.method, self.plan.insertion, flat=self._flat
            )
        return new_pipeline(self.calibration, self._frame_shape, mode, self.plan.method, self.plan.insertion)

    @cached_property
    def _frame_shape(self) -> tuple[int, int]:
        rows, cols = self._frames[0].shape
        return rows, cols


def frame_rate_note(
    calibration: Calibration,
    times_s: Sequence[float] | NDArray[np.float64] | None,
    frame_numbers: Sequence[int] | NDArray[np.int64] | None,
) -> str:
    """Return a message to the user where frames are not as far apart as the calibration's; else an empty one.

    Parameters
    ----------
    calibration : Calibration
        Its timing corrects the rolling shutter.
    times_s : sequence of float or None
        (T,) time of each frame, seconds.
    frame_numbers : sequence of int or None
        (T,) the camera's number of each frame, where gaps are lost frames; None if none were lost.
    """
    period_s = None if times_s is None else median_period_s(times_s, frame_numbers)
    expected_s = calibration.frame_period_s
    if period_s is None or expected_s is None or abs(period_s / expected_s - 1) <= MAX_PERIOD_DIFFERENCE:
        return ""
    return (
        f"the frames are {1e3 * period_s:.2f} ms apart, those of the calibration {1e3 * expected_s:.2f} ms: use one of "
        "this frame rate, since its timing corrects the rolling shutter"
    )


def with_timing(calibration: Calibration, raw_pair: RawPairs, mode: Mode | str) -> tuple[Calibration, str]:
    """Add the line periods per frame to a calibration without them, estimated from the motion in a recording.

    Parameters
    ----------
    calibration : Calibration
        Returned unchanged if it has them.
    raw_pair : RawPairs
        The recording; its first :data:`TIMING_FRAMES` frames are tracked.
    mode : Mode or str
        Image type to track.

    Returns
    -------
    calibration : Calibration
        With the line periods per frame, if the motion constrains them.
    note : str
        Message to the user with the estimate; empty if the calibration had them.
    """
    known = calibration.optics
    if known is not None and known.line_periods_per_frame is not None:
        return calibration, ""
    shape = raw_pair(0)[0].shape
    assumed = calibration.with_optics(line_periods_per_frame=float(shape[0]))
    tracking = RegistrationTracking(assumed, (shape[0], shape[1]), Mode(mode))
    for index in range(min(len(raw_pair), TIMING_FRAMES)):
        tracking.skip(raw_pair.lost_before(index))
        tracking.track(*raw_pair(index))
    found = tracking.line_periods_per_frame()
    if found is None:
        return (
            calibration,
            "rows per frame unknown, and the motion does not constrain them: the rolling shutter is not corrected; "
            "give them with `calibrate --rows-per-frame`",
        )
    note = f"rows per frame estimated from the motion: {found.rows:.1f} +- {found.sigma:.1f}"
    return calibration.with_optics(line_periods_per_frame=found.rows), note
