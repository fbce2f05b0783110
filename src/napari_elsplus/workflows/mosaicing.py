"""The probe's track through a recording, and the mosaic of its images."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

from napari_elsplus.errors import InputError
from napari_elsplus.instrument.arguments import require_calibration, require_frames
from napari_elsplus.io import ImageMetadata, Recording, TrackPoint, refuse_existing, write_mosaic, write_track
from napari_elsplus.processing.images.sectioning import Mode
from napari_elsplus.processing.mosaicing.montage import montage
from napari_elsplus.processing.mosaicing.mosaic import Insertion
from napari_elsplus.processing.progress import without_display
from napari_elsplus.processing.tracking.registry import Method
from napari_elsplus.workflows.mosaic_plan import MosaicPlan
from napari_elsplus.workflows.tracked_stack import TrackedStack
from napari_elsplus.workflows.tracking import calibration_of_finished_images

if TYPE_CHECKING:
    import os
    from collections.abc import Sequence

    import numpy as np
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
        Wraps the frames' numbers: for tracking, for tracking once more where that is needed, and for insertion.

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
    if flat is not None and not (finished and Insertion(insertion) is Insertion.CORES):
        raise InputError("a flat field was given", "it is for finished images and the insertion by cores only")
    stack = _stack(raw, calibration, mode, method, insertion, times_s, frame_numbers, finished=finished, flat=flat)
    stack.track(progress, grow=False, threads=threads)
    stack.finish(progress)
    plan = stack.plan
    canvases = list(stack.canvases[plan.tracked].values())
    largest = max(canvases, key=_area_px, default=None)
    extent = None if largest is None else largest.extent
    return MosaicResult(
        montage(canvases),
        stack.lead.um_per_px,
        stack.lead.rows,
        len(canvases),
        None if finished else stack.calibration,
        {
            "method": plan.method,
            "mode": "finished" if finished else plan.tracked.value,
            "insertion": plan.insertion.value,
        },
        tuple(stack.notes),
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
    stack = _stack(raw, calibration, mode, method, Insertion.DEAD_LEAF, times_s, frame_numbers, finished=finished)
    stack.track(progress, grow=False, threads=2)
    for note in stack.notes:
        warnings.warn(note, stacklevel=2)
    stack.refine(progress)
    return stack.lead.rows


def _stack(
    raw: Frames,
    calibration: Calibration | None,
    mode: Mode | str | None,
    method: str,
    insertion: Insertion | str,
    times_s: Sequence[float] | NDArray[np.float64] | None,
    frame_numbers: Sequence[int] | NDArray[np.int64] | None,
    *,
    finished: bool,
    flat: NDArray[Any] | None = None,
) -> TrackedStack:
    """Return the stack of :func:`mosaic`, with what is known of its times and numbers."""
    _check_arguments(raw, calibration, mode, finished=finished)
    plan = MosaicPlan((Mode.LS if finished else Mode(mode or Mode.ELS),), str(method), Insertion(insertion))
    if isinstance(raw, Recording):
        times_s = raw.times_by(calibration) if times_s is None else times_s
        frame_numbers = raw.frame_numbers if frame_numbers is None else frame_numbers
    elif times_s is None:
        times_s = getattr(raw, "times_s", None)
    by = calibration or calibration_of_finished_images(raw)
    return TrackedStack(raw, by, plan, times_s, frame_numbers, finished=finished, flat=flat)


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


def _area_px(canvas: Canvas) -> int:
    return 0 if canvas.extent is None else canvas.extent.shape[0] * canvas.extent.shape[1]
