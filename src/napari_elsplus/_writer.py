"""The napari writers: an image layer to OME-TIFF or OME-Zarr."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any

import napari
import numpy as np
import pint
from napari.utils import cancelable_progress
from napari.utils.notifications import show_warning

from napari_elsplus._problems import problems
from napari_elsplus.errors import CancelledError, ElsPlusError, InputError, error_message
from napari_elsplus.io import ImageMetadata, beside, write_calibration, write_images, write_mosaic
from napari_elsplus.io.frame_times import median_period_s, uneven_times_s
from napari_elsplus.viewing.common_axes import adopted_axes, frames_per_image
from napari_elsplus.viewing.lazy import UnreadablePlane
from napari_elsplus.viewing.provenance import provenance_of
from napari_elsplus.viewing.stack import first_axis

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.io import Recording


def write_image(path: str, data: Any, attributes: dict[str, Any]) -> list[str]:
    """Write an image layer by the suffix of its file: a stack plane by plane, a single image with a pyramid.

    Parameters
    ----------
    path : str
        The file, replaced if it exists; napari confirms that with the user.
    data : array-like
        (rows, cols) or (T, rows, cols); of a multiscale layer, the full resolution is written.
    attributes : dict
        The layer's attributes: its scale, units and provenance go into the file.

    Returns
    -------
    list of str
        The files written; beside raw frames also their calibration, NAME.calibration.json.

    Raises
    ------
    InputError
        If the layer is in colour or has more dimensions, a plane cannot be read, no format writes the suffix, or the
        user has cancelled it. napari displays the error, and the status line of the dock keeps it.
    OSError
        If the file cannot be written; displayed likewise.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", UnreadablePlane)  # displayed as empty, which must not be saved
            written = _write(path, data, attributes)
    except (ElsPlusError, OSError) as error:
        problems.remember(error_message(error))
        raise
    problems.resolve()
    return written


def _write(path: str, data: Any, attributes: dict[str, Any]) -> list[str]:
    image = _grey(data, attributes)
    provenance = provenance_of(attributes.get("metadata"))
    calibration: Calibration | None = provenance.get("calibration")
    notes = _notes(provenance, attributes)
    step_s, um_per_px = _steps(attributes, image.ndim)
    times_s = _times_s(provenance, len(image)) if image.ndim == 3 else None
    metadata = ImageMetadata(
        um_per_px=um_per_px, frame_period_s=step_s, times_s=times_s, settings=notes, calibration=calibration
    )
    if image.ndim == 2:
        write_mosaic(path, np.asarray(image), metadata, force=True)
    else:
        write_images(path, _planes(image, path), metadata, count=len(image), force=True)
    return [path, *_calibration_of_raw(path, provenance)]


def _planes(image: Any, path: str) -> Iterator[NDArray[Any]]:
    """Yield the planes of a stack, between which the window answers, displays their number, and may cancel.

    Raises
    ------
    CancelledError
        If the user has cancelled it.
    """
    if napari.current_viewer() is None:
        yield from map(np.asarray, image)
        return
    with cancelable_progress(total=len(image), desc=f"saving {path}") as bar:
        for plane in image:
            yield np.asarray(plane)
            bar.update()
            if bar.is_canceled:
                raise CancelledError(f"{path} was not saved, as you cancelled it", "save it again when you like")


def _calibration_of_raw(path: str, provenance: Mapping[str, Any]) -> list[str]:
    """Write the calibration beside raw frames, background and all, so that they give the same images again."""
    calibration: Calibration | None = provenance.get("calibration")
    if provenance.get("kind") != "raw" or calibration is None:
        return []
    return [str(write_calibration(beside(path, ".calibration.json"), calibration, force=True))]


def _grey(data: Any, attributes: Mapping[str, Any]) -> Any:
    full = data[0] if attributes.get("multiscale") or isinstance(data, list | tuple) else data
    if attributes.get("rgb") or full.ndim not in (2, 3):
        raise InputError(
            f"the layer {attributes.get('name', '')!r} has shape {tuple(full.shape)}",
            "an image (rows, cols) or a stack (T, rows, cols) of grey levels can be written",
        )
    return full


def _steps(attributes: Mapping[str, Any], ndim: int) -> tuple[float | None, float | None]:
    """Return seconds per plane and micrometres per pixel; None where units are others, or the axis another layer's."""
    scale: Sequence[float] = attributes.get("scale", (1.0,) * ndim)
    units: Sequence[Any] = attributes.get("units") or ("pixel",) * ndim
    adopted = adopted_axes(attributes.get("metadata"), ndim)
    first, provenance = (units[0], scale[0]), provenance_of(attributes.get("metadata"))
    if adopted[0] and ndim == 3 and provenance.get("stack") is not None:
        own = first_axis(provenance["stack"], provenance.get("calibration"))
        first = own["units"], own["scale"] * frames_per_image(provenance["kind"])
    step_s = _in(first[0], "second", first[1]) if ndim == 3 else None
    return step_s, None if adopted[-1] else _in(units[-1], "micrometer", scale[-1])


def _times_s(provenance: Mapping[str, Any], count: int) -> tuple[float, ...] | None:
    """Return the times of a layer's planes in seconds, (count,), where their recording has them and they are uneven.

    Warns where they are those of a video's playback, and where a layer has other planes than its recording.
    """
    recording: Recording | None = getattr(provenance.get("stack"), "recording", None)
    if recording is None:
        return None
    calibration: Calibration | None = provenance.get("calibration")
    times_s = recording.times_by(calibration)
    period_s = None if times_s is None else median_period_s(times_s, recording.frame_numbers)
    uneven = uneven_times_s(times_s, period_s)
    if uneven is None:
        return None
    if recording.camera_times_by(calibration) is None:
        show_warning(f"{recording.path.name} has the times of its playback, and these are saved")
    kind = provenance.get("kind")
    per_image = frames_per_image(kind)
    if count != len(recording) // per_image:
        show_warning(
            f"the frames of {recording.path.name} are uneven in time, and these are {count} planes of "
            f"{len(recording)} frames: their interval is saved, not their times"
        )
        return None
    return uneven[::per_image][:count]


def _in(unit: Any, target: str, value: float) -> float | None:
    try:
        return float(pint.Quantity(value, str(unit)).to(target).magnitude)
    except (pint.DimensionalityError, pint.UndefinedUnitError, AttributeError):
        return None


def _notes(provenance: Mapping[str, Any], attributes: Mapping[str, Any]) -> dict[str, Any]:
    notes = {"layer": str(attributes.get("name", ""))}
    if "kind" in provenance:
        notes["mode"] = str(provenance["kind"])
    if provenance.get("path") is not None:
        notes["recording"] = str(provenance["path"].name)
    return notes
