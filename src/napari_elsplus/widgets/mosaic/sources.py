"""Sources of mosaics: raw recordings with their calibration, and stacks of finished images."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from napari.layers import Image

from napari_elsplus.errors import InputError
from napari_elsplus.processing.images.sectioning import Mode
from napari_elsplus.viewing.common_axes import adopted_axes
from napari_elsplus.viewing.lazy import LazyPlanes
from napari_elsplus.viewing.provenance import provenance_of
from napari_elsplus.widgets.shared.choosing import is_raw, is_uncalibrated
from napari_elsplus.workflows.tracking import calibration_of_finished_images

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    import napari.viewer
    from napari.layers import Layer

    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.processing.images.sectioning import Frames
    from napari_elsplus.workflows.mosaic_plan import MosaicPlan


@dataclass(frozen=True)
class MosaicSource:
    """Frames with their calibration and metadata.

    Attributes
    ----------
    frames : Frames
        (T, rows, cols).
    calibration : Calibration
        Of the frames; nominal for finished images.
    times_s : sequence of float, optional
        Acquisition times.
    frame_numbers : sequence of int, optional
        The camera's numbers; gaps are lost frames.
    title : str, optional
        Title of finished images, of which only one mosaic can be made; None for raw frames.
    """

    frames: Frames
    calibration: Calibration
    times_s: Sequence[float] | None
    frame_numbers: Sequence[int] | None
    title: str | None = None

    @property
    def finished(self) -> bool:
        """True for finished images."""
        return self.title is not None

    def plan(self, wanted: MosaicPlan) -> MosaicPlan:
        """Return the wanted plan, restricted to one mode for finished images."""
        return replace(wanted, modes=(Mode.LS,)) if self.finished else wanted


def source_names(viewer: napari.viewer.Viewer) -> list[str]:
    """Return the names of a viewer's layers that mosaics can be made of, raw recordings first."""
    usable = [layer for layer in viewer.layers if isinstance(layer, Image) and _usable(layer)]
    return [layer.name for layer in sorted(usable, key=lambda layer: not is_raw(layer))]


def are_finished_images(layer: Layer, *, ticked: bool, calibrated: bool) -> bool:
    """Return True for a layer of finished images, of which one mosaic is made, whatever image types are selected.

    Parameters
    ----------
    layer : napari.layers.Layer
        One of :func:`source_names`.
    ticked : bool
        The user declares what was opened as raw frames without a calibration to be finished images.
    calibrated : bool
        The user has selected a calibration, by which the frames are raw.
    """
    return not calibrated and (not is_raw(layer) or (ticked and is_uncalibrated(layer)))


def source_of(layer: Image, given: Calibration | None, path: Path | None, *, finished: bool = False) -> MosaicSource:
    """Return the source of a mosaic from a layer.

    Parameters
    ----------
    layer : napari.layers.Image
        One of :func:`source_names`.
    given : Calibration, optional
        Selected by the user, replaces that of the layer.
    path : pathlib.Path, optional
        Its file.
    finished : bool
        What was opened as raw frames, and has no calibration, are finished images.

    Raises
    ------
    InputError
        If raw frames have no calibration, or the given one is for frames of another size.
    """
    facts, shape = provenance_of(layer.metadata), tuple(layer.data.shape)
    calibration = given or (facts.get("calibration") if is_raw(layer) else None)
    raw = is_raw(layer) and not (finished and calibration is None)
    if raw and calibration is None:
        raise InputError(
            f"{layer.name} has no calibration",
            "select a calibration file above, drop one on the window and open the recording again, or calibrate; if "
            "another microscope made it, tick finished images",
        )
    frame = None if given is None else given.frame
    if frame is not None and tuple(frame.shape) != shape[1:]:
        assert path is not None
        raise InputError(
            f"{path.name} is for frames of {frame.shape[0]} x {frame.shape[1]} pixels, "
            f"{layer.name} has {shape[1]} x {shape[2]}",
            "choose the calibration that belongs to it, or none",
        )
    stack = facts.get("stack")
    recording = None if stack is None else stack.recording
    times_s = None if recording is None else recording.times_by(calibration)
    data = layer.data
    frames = (
        stack.planes
        if stack is not None and raw
        else LazyPlanes(lambda index: np.asarray(data[index]), data.shape, data.dtype)
    )
    if calibration is not None:
        numbers = None if recording is None else recording.frame_numbers
        return MosaicSource(frames, calibration, times_s, numbers)
    measured = str(layer.units[-1]) in ("micrometer", "um") and not adopted_axes(layer.metadata, layer.ndim)[-1]
    um = float(layer.scale[-1]) if measured else None
    title = stack.name if stack is not None and is_raw(layer) else layer.name
    return MosaicSource(frames, calibration_of_finished_images(frames, um), times_s, None, title)


def _usable(layer: Image) -> bool:
    """Return True for a stack of grey levels that was not derived from a raw layer."""
    stack = provenance_of(layer.metadata).get("stack")
    derived = stack is not None and not is_raw(layer) and stack.planes.dtype.kind != "f"
    return layer.ndim == 3 and not layer.rgb and not layer.multiscale and not derived
