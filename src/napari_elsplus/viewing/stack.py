"""Stacks of planes with their metadata, and the axes (scale, origin, units) of their layers."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from napari_elsplus.errors import CalibrationError, InputError
from napari_elsplus.io import Recording, existing_beside, read_depths_um
from napari_elsplus.io.formats.ome_xml import SOFTWARE
from napari_elsplus.io.formats.registry import recording_stem
from napari_elsplus.processing.images.sectioning import side_px
from napari_elsplus.viewing.lazy import LazyPlanes, raw_planes
from napari_elsplus.viewing.provenance import PROVENANCE

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import Calibration

TIME: Final = "time"
"""Label of the first axis of the layers of a recording that is no axial scan."""


@dataclass(frozen=True)
class Stack:
    """A stack of planes with its metadata.

    Attributes
    ----------
    name : str
        Prefix of its layers' names.
    planes : LazyPlanes
        Raw frames, or finished images.
    metadata : dict
        ``um_per_px``, ``frame_period_s``, ``settings``, where known.
    recording : Recording, optional
        Source of the planes; None if they are simulated.
    depth_um : numpy.ndarray, optional
        (T,) if the stack is an axial scan.
    """

    name: str
    planes: LazyPlanes
    metadata: dict[str, Any] = field(default_factory=dict)
    recording: Recording | None = None
    depth_um: NDArray[np.float64] | None = None

    @classmethod
    def of(cls, recording: Recording) -> Stack:
        """Return the stack of an open recording, an axial scan if NAME.depths.csv lies beside it."""
        depths = existing_beside(recording.path, ".depths.csv")
        depth_um = None if depths is None else read_depths_um(depths)
        if depths is not None and depth_um is not None and len(depth_um) != len(recording):
            raise InputError(
                f"{depths.name} holds {len(depth_um)} depths, {recording.path.name} {len(recording)} frames",
                "correct the file to one depth per frame, or remove it",
            )
        name = recording_stem(recording.path.name)
        return cls(name, raw_planes(recording), recording.metadata, recording, depth_um)

    @property
    def file_name(self) -> str:
        """Name of the recording's file, or of the stack."""
        return self.recording.path.name if self.recording is not None else self.name

    def own_calibration(self) -> Calibration | None:
        """Return the recording's own calibration; None if there is none or it is broken."""
        try:
            return self.recording.calibration if self.recording is not None else None
        except CalibrationError:
            return None


def space(um_per_px: float | None, origin_px: tuple[float, float] = (0.0, 0.0)) -> dict[str, Any]:
    """Return scale, translation, units and labels of the two axes of an image, as napari's layer attributes.

    Parameters
    ----------
    um_per_px : float or None
        Scale; axes in pixels if unknown.
    origin_px : tuple of float
        Row and column of the image's first pixel.
    """
    scale = um_per_px or 1.0
    return {
        "scale": (scale, scale),
        "translate": (origin_px[0] * scale, origin_px[1] * scale),
        "units": ("um", "um") if um_per_px else ("pixel", "pixel"),
        "axis_labels": ("row", "col"),
    }


def um_per_px_of(stack: Stack, calibration: Calibration | None) -> float | None:
    """Return the scale of a stack, from its file or else from its calibration; None if neither has it."""
    known: float | None = stack.metadata.get("um_per_px")
    return calibration.um_per_px if known is None and calibration is not None else known


def images_origin_px(calibration: Calibration) -> tuple[float, float]:
    """Return row and column of the raw frame at which images of a calibration's confocal view begin.

    Raises
    ------
    CalibrationError
        If the bundle was not located.
    """
    bundle = calibration.measured_bundle
    middle = (side_px(bundle.diameter_px) - 1) / 2
    row, col = bundle.confocal_centre
    return row - middle, col - middle


def first_axis(stack: Stack, calibration: Calibration | None) -> dict[str, Any]:
    """Return scale, translation, unit and label of the first axis of a stack, from its file or a calibration."""
    if stack.depth_um is not None:
        steps = np.diff(stack.depth_um)
        even = len(steps) > 0 and steps[0] > 0 and np.allclose(steps, steps[0], rtol=1e-3)
        if not even:
            return {"scale": 1.0, "translate": 0.0, "units": "pixel", "axis_labels": "depth"}
        first = float(stack.depth_um[0])
        return {"scale": float(steps[0]), "translate": first, "units": "um", "axis_labels": "depth"}
    period_s, calibrated_s = stack.metadata.get("frame_period_s"), calibration and calibration.frame_period_s
    if calibrated_s and (period_s is None or stack.metadata.get("playback")):
        period_s = calibrated_s
    return {
        "scale": period_s or 1.0,
        "translate": 0.0,
        "units": "s" if period_s else "pixel",
        "axis_labels": TIME,
    }


def attributes(
    stack: Stack, title: str, calibration: Calibration | None, origin_px: tuple[float, float] = (0.0, 0.0)
) -> dict[str, Any]:
    """Return name, scale, translation, units and labels of a layer (T or depth, rows, cols).

    Parameters
    ----------
    stack : Stack
        Gives the first axis and the scale.
    title : str
        Appended to the stack's name.
    calibration : Calibration or None
        Gives scale and frame period where the file lacks them.
    origin_px : tuple of float
        Row and column of the image's first pixel.
    """
    place, first = space(um_per_px_of(stack, calibration), origin_px), first_axis(stack, calibration)
    return {"name": f"{stack.name} {title}"} | {key: (first[key], *place[key]) for key in place}


def provenance(stack: Stack, kind: str, calibration: Calibration | None, source: Path | None) -> dict[str, Any]:
    """Return the provenance of a layer, for its metadata.

    Parameters
    ----------
    stack : Stack
        The recording it was made from.
    kind : str
        ``raw``, or the mode of the images.
    calibration : Calibration or None
        Used to make it.
    source : pathlib.Path or None
        The calibration's file.
    """
    return {
        PROVENANCE: {
            "kind": kind,
            "stack": stack,
            "path": stack.recording.path if stack.recording is not None else None,
            "calibration": calibration,
            "calibration_path": source,
            "file": dict(stack.metadata),
            "software": SOFTWARE,
        }
    }
