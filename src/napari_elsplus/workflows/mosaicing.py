"""The probe's track through a recording, and the mosaic of its images."""

from __future__ import annotations

import warnings
from contextlib import nullcontext
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from napari_elsplus.errors import InputError
from napari_elsplus.instrument.arguments import require_calibration, require_frames
from napari_elsplus.io import ImageMetadata, Recording, TrackPoint, refuse_existing, write_mosaic, write_track
from napari_elsplus.processing.calibration.bundle.agreement import agreement_note
from napari_elsplus.processing.images.sectioning import Mode
from napari_elsplus.processing.mosaicing.montage import montage
from napari_elsplus.processing.mosaicing.mosaic import Insertion
from napari_elsplus.processing.progress import without_display
from napari_elsplus.processing.tracking.motion.pose import TrackingState
from napari_elsplus.processing.tracking.registry import Method, tracking_method
from napari_elsplus.workflows.core_mosaicing.pipeline import new_finished_pipeline, new_pipeline
from napari_elsplus.workflows.line_timing import frame_rate_note, with_timing
from napari_elsplus.workflows.sectioning import RawPairs
from napari_elsplus.workflows.tracking import UNLINKED, Pipeline, calibration_of_finished_images
from napari_elsplus.workflows.two_threads import Pipelined

if TYPE_CHECKING:
    import os
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.processing.images.sectioning import Frames
    from napari_elsplus.processing.mosaicing.tiles import Canvas
    from napari_elsplus.processing.progress import Progress


@dataclass(frozen=True)
class MosaicResult:
    """A mosaic and the track along which its images were inserted.

    Attributes
    ----------
    image : numpy.ndarray
        (rows, cols) float32 grey levels; 0 where nothing was inserted. Segments lie below one another, the largest
        first.
    um_per_px : float or None
        Micrometres per pixel of the mosaic; None without a scale in the calibration.
    track : list of TrackPoint
        A row for every frame (for every second frame with ELSA).
    segments : int
        Number of segments: runs of frames that are registered to one another.
    calibration : Calibration or None
        As it was given, with the line periods per frame if they were estimated from the motion; None for finished
        images.
    settings : dict
        ``mode`` (``finished`` for finished images), ``method`` and ``insertion``, as they are written into the file.
    notes : tuple of str
        Messages to the user: another frame rate or bit depth than the calibration's, an estimated timing, too few
        tracked frames.
    first_frame_px : tuple of float
        Row and column of the image at which the largest segment's track begins.
    """

    image: NDArray[np.float32]
    um_per_px: float | None
    track: list[TrackPoint]
    segments: int
    calibration: Calibration | None
    settings: dict[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    first_frame_px: tuple[float, float] = (0.0, 0.0)

    def save(
        self, path: str | os.PathLike[str], track: str | os.PathLike[str] | None = None, *, force: bool = False
    ) -> None:
        """Write the mosaic with its pyramid in the suffix's format, and the track to a CSV file.

        Parameters
        ----------
        path : path-like
            File of the mosaic: ``NAME.ome.tif`` for OME-TIFF, ``NAME.ome.zarr`` for OME-Zarr.
        track : path-like, optional
            File of the track; not written by default.
        force : bool
            Overwrite existing files.

        Raises
        ------
        InputError
            If no format writes the suffix, or a file exists and `force` is not given; then neither is written.
        """
        for target in (path, track):
            if target is not None:
                refuse_existing(target, force=force)
        known = ImageMetadata(um_per_px=self.um_per_px, settings=self.settings, calibration=self.calibration)
        write_mosaic(path, self.image, known, force=force)
        if track is not None:
            write_track(track, self.track, force=force)


def mosaic(
    raw: Frames,
    calibration: Calibration | None = None,
    mode: Mode | str | None = None,
    *,
    finished: bool = False,
    method: str = Method.ELSPLUS,
    insertion: Insertion | str = Insertion.DEAD_LEAF,
    flat: NDArray[Any] | None = None,
    times_s: Sequence[float] | NDArray[np.float64] | None = None,
    frame_numbers: Sequence[int] | NDArray[np.int64] | None = None,
    threads: Literal[1, 2] = 2,
    progress: Progress = without_display,
) -> MosaicResult:
    """Track the probe through raw frames or finished images, and insert the images into a mosaic.

    Parameters
    ----------
    raw : Frames
        Frames (rows, cols): an array (T, rows, cols), a list, or an open recording.
    calibration : Calibration, optional
        Of the rig that recorded raw frames; needs the bundle section. Line periods per frame that it lacks are
        estimated from the motion. None for finished images.
    mode : Mode or str, optional
        Image type to track and insert: ``"els"`` (the default), ``"ls"``, ``"residual"`` or ``"elsa"``. None for
        finished images.
    finished : bool
        True for finished images of any microscope, which are tracked and inserted at their own resolution. Repeated
        frames of a video have the position of their twin; positions in micrometres are nan.
    method : str
        Tracking method: ``"elsplus"`` (sub-pixel, rolling shutter corrected), ``"paper"`` (template matching), or one
        that was registered.
    insertion : Insertion or str
        Rule by which overlapping images are combined. ``"cores"`` samples the scene core by core, which makes the
        mosaic of a probe that moved finer than the cores; finished images must then show the cores.
    flat : numpy.ndarray, optional
        (rows, cols) evenly lit image of the bundle that finished images were taken through, in which ``"cores"`` finds
        the cores; the mean of the frames by default.
    times_s : sequence of float, optional
        (T,) time of each frame; the recording's by default.
    frame_numbers : sequence of int, optional
        (T,) the camera's number of each frame, by which frames that it lost are known, and with them how far the probe
        may have moved meanwhile; the recording's by default, none lost in an array.
    threads : int
        2 to register a frame while the next is sectioned, 1 where the cores are shared; the result is the same.
    progress : Progress
        Wraps the frames' numbers, once for tracking and once for insertion.

    Returns
    -------
    MosaicResult

    Raises
    ------
    InputError
        If there are no frames, none could be tracked, raw frames have no calibration or are given as finished images,
        or finished images have a calibration; for ``"cores"`` also if the cores are not resolved, or the frames did not
        move.
    CalibrationError
        If the calibration does not fit the frames.
    """
    _check_arguments(raw, calibration, mode, finished=finished)
    if flat is not None and not (finished and Insertion(insertion) is Insertion.CORES):
        raise InputError("a flat field was given", "it is for finished images and the insertion by cores only")
    shown = Mode.LS if finished else Mode(mode or Mode.ELS)
    times_s = _times_s(raw, calibration) if times_s is None else times_s
    pipeline, calibration, notes = _tracked(
        raw, calibration, shown, method, insertion, times_s, frame_numbers, threads, progress, flat
    )  # fmt: skip
    pipeline.finish(RawPairs(raw, shown), lambda numbers: progress(numbers, "Mosaic"))
    largest = max(pipeline.mosaics.values(), key=_area_px, default=None)
    extent = None if largest is None else largest.extent
    return MosaicResult(
        montage(list(pipeline.mosaics.values())),
        pipeline.um_per_px,
        pipeline.rows,
        len(pipeline.mosaics),
        calibration,
        {
            "method": str(method),
            "mode": "finished" if finished else shown.value,
            "insertion": Insertion(insertion).value,
        },
        notes + notes_on(pipeline),
        (0.0, 0.0) if extent is None else (-float(extent.top), -float(extent.left)),
    )


def track(
    raw: Frames,
    calibration: Calibration | None = None,
    mode: Mode | str | None = None,
    *,
    finished: bool = False,
    method: str = Method.ELSPLUS,
    times_s: Sequence[float] | NDArray[np.float64] | None = None,
    frame_numbers: Sequence[int] | NDArray[np.int64] | None = None,
    progress: Progress = without_display,
) -> list[TrackPoint]:
    """Track the probe through raw frames or finished images; the track of :func:`mosaic` without its images.

    Parameters and errors are those of :func:`mosaic`. What are notes there are Python warnings here.

    Returns
    -------
    list of TrackPoint
        A row for every frame (for every second frame with ELSA): position of the probe in camera pixels and
        micrometres, relative to the first frame of its segment, with its standard deviation and state.
    """
    _check_arguments(raw, calibration, mode, finished=finished)
    shown = Mode.LS if finished else Mode(mode or Mode.ELS)
    times_s = _times_s(raw, calibration) if times_s is None else times_s
    pipeline, _, notes = _tracked(
        raw, calibration, shown, method, Insertion.DEAD_LEAF, times_s, frame_numbers, 2, progress
    )  # fmt: skip
    for note in notes:
        warnings.warn(note, stacklevel=2)
    pipeline.refine(RawPairs(raw, shown))
    return pipeline.rows


def _check_arguments(raw: Frames, calibration: Calibration | None, mode: Mode | str | None, *, finished: bool) -> None:
    """Raise an error if raw frames have no calibration or are taken for finished, or finished images have either."""
    require_frames(raw)
    if finished and calibration is not None:
        raise InputError("finished images have no calibration", "leave out the calibration, or `finished`")
    if finished and isinstance(raw, Recording) and raw.holds_raw_frames:
        raise InputError(
            f"{raw.path.name} contains raw frames, two views side by side, and the calibration of their rig",
            "leave out --finished (in Python `finished`), so that the images made of them are tracked",
        )
    if finished and mode is not None:
        raise InputError(f"finished images have no mode, {mode} was given", "leave out the mode, or `finished`")
    if not finished and calibration is None:
        raise InputError("raw frames need a calibration", "give one, or `finished` for finished images")
    if calibration is not None:
        require_calibration(calibration)


def _tracked(
    raw: Frames,
    calibration: Calibration | None,
    mode: Mode,
    method: str,
    insertion: Insertion | str,
    times_s: Sequence[float] | NDArray[np.float64] | None,
    frame_numbers: Sequence[int] | NDArray[np.int64] | None,
    threads: Literal[1, 2],
    progress: Progress,
    flat: NDArray[Any] | None = None,
) -> tuple[Pipeline, Calibration | None, tuple[str, ...]]:
    """Track all frames on one thread or two; return the pipeline, the calibration with its timing, and notes.

    Frames without a calibration are finished images.
    """
    if frame_numbers is None and isinstance(raw, Recording):
        frame_numbers = raw.frame_numbers
    for name, values in (("times", times_s), ("frame numbers", frame_numbers)):
        if values is not None and len(values) != len(raw):
            raise InputError(f"{len(values)} {name} for {len(raw)} frames", "give one for each frame")
    pairs, notes = RawPairs(raw, mode, frame_numbers), list[str]()
    if calibration is None:
        nominal = calibration_of_finished_images(raw)
        pipeline = new_finished_pipeline(raw, nominal, method, insertion, flat=flat)
    else:
        rows, cols = raw[0].shape
        calibration, notes = calibration_to_track_by(raw, calibration, pairs, mode, method, times_s)
        pipeline = new_pipeline(calibration, (rows, cols), mode, method, insertion)
    with Pipelined(pipeline, insert=False) if threads == 2 else nullcontext() as ahead:
        skip, add = (pipeline.skip, pipeline.track) if ahead is None else (ahead.skip, ahead.add)
        for index in progress(range(len(pairs)), "Tracking"):
            frame = pairs.frame(index)
            confocal, residual = pairs(index)
            skip(pairs.lost_before(index))
            add(confocal, frame, np.nan if times_s is None else float(times_s[frame]), residual)
    return pipeline, calibration, tuple(notes)


def calibration_to_track_by(
    raw: Frames,
    calibration: Calibration,
    pairs: RawPairs,
    mode: Mode,
    method: str,
    times_s: Sequence[float] | NDArray[np.float64] | None,
) -> tuple[Calibration, list[str]]:
    """Return the calibration with the timing that raw frames are tracked by, and messages to the user.

    Parameters
    ----------
    raw : Frames
        Raw frames (rows, cols).
    calibration : Calibration
        As it was given. Line periods per frame that it lacks are estimated if the method needs them.
    pairs : RawPairs
        The same frames in the pairs of the mode.
    mode : Mode
        Image type to track.
    method : str
        Name of the tracking method.
    times_s : sequence of float or None
        (T,) time of each frame, seconds.

    Raises
    ------
    CalibrationError
        If the calibration is of another rig than the frames.
    """
    notes = [agreement_note(raw, calibration), frame_rate_note(calibration, times_s, pairs.frame_numbers)]
    if tracking_method(method).corrects_rolling_shutter:
        calibration, note = with_timing(calibration, pairs, mode)
        notes.append(note)
    return calibration, [note for note in notes if note]


def notes_on(pipeline: Pipeline) -> tuple[str, ...]:
    """Return messages to the user on a finished `pipeline`: light that was taken out, and too few tracked frames."""
    tracked = sum(row.state == TrackingState.TRACKED for row in pipeline.rows)
    return _uneven_light(pipeline) + ((UNLINKED,) if tracked < 2 else ())


def _times_s(raw: Frames, calibration: Calibration | None) -> Sequence[float] | NDArray[np.float64] | None:
    """Return the time of each frame, (T,), as far as the frames have them."""
    return raw.times_by(calibration) if isinstance(raw, Recording) else getattr(raw, "times_s", None)


def _uneven_light(pipeline: Pipeline) -> tuple[str, ...]:
    """Return a note on the light that was taken out of the mosaics; empty where it was even."""
    light = pipeline.line_light
    if light is None or not light.uneven:
        return ()
    low, high = (100 * float(part) for part in np.percentile(light.relative, (5, 95)))
    return (f"uneven light along the line, {low:.0f} to {high:.0f} % of its mean, was taken out",)


def _area_px(canvas: Canvas) -> int:
    return 0 if canvas.extent is None else canvas.extent.shape[0] * canvas.extent.shape[1]
