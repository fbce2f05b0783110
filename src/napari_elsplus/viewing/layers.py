"""What a recording or a calibration becomes in a viewer: layers with their scale, units, names and provenance.

A layer is napari's triple (data, attributes, type), plain data that needs no viewer.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from napari_elsplus import __version__
from napari_elsplus.errors import CalibrationError, ElsPlusError
from napari_elsplus.io import calibration_beside, open_recording, read_calibration
from napari_elsplus.processing.quality import white_level
from napari_elsplus.processing.sectioning import Mode, side_px
from napari_elsplus.viewing.lazy import image_planes, raw_planes

if TYPE_CHECKING:
    import os

    from napari_elsplus.calibration import BundleSection, Calibration
    from napari_elsplus.io import Recording
    from napari_elsplus.viewing.lazy import LazyPlanes

    Layer = tuple[Any, dict[str, Any], str]

TITLES: Final = {Mode.LS: "LS", Mode.RESIDUAL: "residual", Mode.ELS: "ELS+", Mode.ELSA: "ELSA"}
"""Names that microscopists know the modes by."""
OUTLINE_COLOURS: Final = ("#56b4e9", "#e69f00")
"""Of the confocal and the residual outline: blue and orange, told apart by everyone."""


@dataclass(frozen=True)
class Opened:
    """What a file became.

    Attributes
    ----------
    layers : list of tuple
        (data, attributes, type) each.
    notes : list of str
        What the user should be told: why there are no images, which calibration was taken.
    """

    layers: list[Layer]
    notes: list[str]


def open_layers(path: str | os.PathLike[str], in_force: Path | None = None) -> Opened:
    """Open a recording as lazy layers: the raw frames and, with a calibration, LS, residual, ELS+ and ELSA.

    Parameters
    ----------
    path : path-like
        Any recording that :func:`napari_elsplus.io.open_recording` opens.
    in_force : pathlib.Path, optional
        Calibration file for a recording that has none in it or beside it.

    Returns
    -------
    Opened
        Nothing is loaded but the first frame. A recording whose calibration is broken or does not fit gives its raw
        layer and a note.

    Raises
    ------
    InputError
        If it is no recording.
    """
    recording = open_recording(path)
    if recording.dtype.kind == "f":
        return Opened([finished_layer(recording)], [])
    planes, notes = raw_planes(recording), []
    try:
        calibration, source = calibration_for(recording, in_force)
        layers = [] if calibration is None else image_layers(recording, planes, calibration, source)
        if source is not None and source == in_force:
            notes.append(f"{recording.path.name} is shown with the calibration in force, {source.name}")
    except ElsPlusError as error:
        calibration, layers = None, []
        notes.append(f"{recording.path.name} is shown as raw frames only. {error}")
    raw = raw_layer(recording, planes, calibration)
    raw[1]["visible"] = not layers
    return Opened([raw, *layers], notes)


def calibration_for(recording: Recording, in_force: Path | None = None) -> tuple[Calibration | None, Path | None]:
    """Find the calibration of a recording: beside it, in it, or the one in force; and its file, if it has one.

    Raises
    ------
    CalibrationError
        If there is one and it is broken.
    """
    own = recording.calibration
    if own is not None:
        return own, calibration_beside(recording.path)
    if in_force is None:
        return None, None
    return read_calibration(in_force), in_force


def raw_layer(recording: Recording, planes: LazyPlanes, calibration: Calibration | None) -> Layer:
    """Raw frames as a layer."""
    step_um, step_s = _steps(recording, calibration)
    attributes = _attributes(f"{_stem(recording)} raw", step_um, step_s, origin_px=(0.0, 0.0))
    attributes["metadata"] = _provenance(recording, "raw", calibration, None)
    attributes["contrast_limits"] = _limits(float(planes[0].max()))
    return planes.dask(), attributes, "image"


def image_layers(
    recording: Recording, planes: LazyPlanes, calibration: Calibration, source: Path | None = None
) -> list[Layer]:
    """LS, residual, ELS+ and, of more than one frame, ELSA; each where it lies in the raw frame, ELS+ shown.

    Raises
    ------
    CalibrationError
        If the calibration has no bundle or does not fit the frames.
    """
    calibration.require("bundle")
    assert calibration.bundle is not None
    side = side_px(calibration.bundle.diameter_px)
    row, col = calibration.bundle.confocal_centre
    origin_px = (row - (side - 1) / 2, col - (side - 1) / 2)
    step_um, step_s = _steps(recording, calibration)
    layers: list[Layer] = []
    for mode, title in TITLES.items():
        if mode is Mode.ELSA and len(recording) < 2:
            continue
        images = image_planes(planes, calibration, mode)
        step = 2 * step_s if mode is Mode.ELSA and step_s is not None else step_s
        attributes = _attributes(f"{_stem(recording)} {title}", step_um, step, origin_px)
        if mode is Mode.ELSA and step_s is None:
            attributes["scale"] = (2.0, *attributes["scale"][1:])
        attributes["visible"] = mode is Mode.ELS
        attributes["metadata"] = _provenance(recording, mode.value, calibration, source)
        first = images[0]
        attributes["contrast_limits"] = _limits(white_level(first, np.ones(first.shape, np.bool_)))
        layers.append((images.dask(), attributes, "image"))
    return layers


def finished_layer(recording: Recording) -> Layer:
    """Images that were processed before, as a layer."""
    planes = raw_planes(recording)
    settings = recording.metadata.get("settings")
    mode = settings.get("mode") if isinstance(settings, dict) else None
    title = TITLES.get(mode, "images") if isinstance(mode, str) else "images"  # type: ignore[call-overload]
    try:
        calibration = recording.calibration
    except CalibrationError:
        calibration = None
    attributes = _attributes(f"{_stem(recording)} {title}", *_steps(recording, calibration), (0.0, 0.0))
    first = planes[0]
    attributes["contrast_limits"] = _limits(white_level(first, np.ones(first.shape, np.bool_)))
    attributes["metadata"] = _provenance(recording, mode or "images", calibration, None)
    return planes.dask(), attributes, "image"


def calibration_layers(path: str | os.PathLike[str]) -> Opened:
    """Show a calibration: the outlines of the two bundle images, in the raw frame's pixels or micrometres.

    Parameters
    ----------
    path : path-like
        A calibration's JSON file.

    Returns
    -------
    Opened
        A shapes layer if the bundle was located, and a line that says what the calibration holds.

    Raises
    ------
    CalibrationError
        If it is broken.
    """
    path = Path(path)
    calibration = read_calibration(path)
    note = f"{path.name} is the calibration in force: {summary(calibration)}"
    bundle = calibration.bundle
    if bundle is None:
        return Opened([], [note])
    step_um = calibration.optics.um_per_px if calibration.optics is not None else None
    attributes = _attributes(f"{path.name.removesuffix('.json')} bundle", step_um, None, (0.0, 0.0), dimensions=2)
    attributes |= {
        "shape_type": "ellipse",
        "edge_color": list(OUTLINE_COLOURS),
        "face_color": "transparent",
        "edge_width": max(1.0, bundle.diameter_px / 150),
        "features": {"view": ["confocal", "residual"]},
        "text": {"string": "{view}", "color": list(OUTLINE_COLOURS), "anchor": "upper_left", "size": 10},
        "metadata": {"elsplus": {"kind": "calibration", "calibration": calibration, "calibration_path": path}},
    }
    return Opened([(_outlines(bundle), attributes, "shapes")], [note])


def summary(calibration: Calibration) -> str:
    """Say in a line what a calibration holds, and how good it is.

    Examples
    --------
    >>> from napari_elsplus.calibration import Calibration
    >>> summary(Calibration.parse({"offset": {"rows": -12.03, "uncertainty_rows": 0.01}}))
    'slit offset -12.03 ± 0.01 rows'
    """
    said = []
    if calibration.offset is not None:
        said.append(f"slit offset {calibration.offset.rows:.2f} ± {calibration.offset.uncertainty_rows:.2f} rows")
    if calibration.bundle is not None:
        said.append(f"bundle {calibration.bundle.diameter_px:.1f} px wide")
    if calibration.galvo is not None:
        said.append(f"mirror {1e3 * calibration.galvo.volts_per_row:.3f} mV per row")
    if calibration.quality is not None:
        said.append(f"alignment error {100 * calibration.quality.alignment_error:.1f} %")
    if calibration.background is not None:
        said.append("background")
    return ", ".join(said) or "it holds no measured section"


def _outlines(bundle: BundleSection) -> list[np.ndarray[Any, np.dtype[np.float64]]]:
    radius = bundle.diameter_px / 2
    corners = radius * np.array([(-1, -1), (-1, 1), (1, 1), (1, -1)], np.float64)
    return [np.add(centre, corners) for centre in (bundle.confocal_centre, bundle.residual_centre)]


def _steps(recording: Recording, calibration: Calibration | None) -> tuple[float | None, float | None]:
    """Micrometres per pixel and seconds per frame, as far as the file or its calibration know them."""
    step_um, step_s = recording.metadata.get("um_per_px"), recording.metadata.get("frame_period_s")
    optics = calibration.optics if calibration is not None else None
    if optics is not None:
        step_um = step_um or optics.um_per_px
        if step_s is None and optics.line_period_s and optics.rows_per_frame:
            step_s = optics.line_period_s * optics.rows_per_frame
    return step_um, step_s


def _attributes(
    name: str, step_um: float | None, step_s: float | None, origin_px: tuple[float, float], dimensions: int = 3
) -> dict[str, Any]:
    scale_px = step_um or 1.0
    scale = (step_s or 1.0, scale_px, scale_px)
    translate = (0.0, origin_px[0] * scale_px, origin_px[1] * scale_px)
    units = ("s" if step_s else "pixel", *(("um", "um") if step_um else ("pixel", "pixel")))
    labels = ("time", "row", "col")
    return {
        "name": name,
        "scale": scale[-dimensions:],
        "translate": translate[-dimensions:],
        "units": units[-dimensions:],
        "axis_labels": labels[-dimensions:],
    }


def _provenance(
    recording: Recording, kind: str, calibration: Calibration | None, source: Path | None
) -> dict[str, Any]:
    return {
        "elsplus": {
            "kind": kind,
            "path": recording.path,
            "recording": recording,
            "calibration": calibration,
            "calibration_path": source,
            "file": dict(recording.metadata),
            "software": f"napari-elsplus {__version__}",
        }
    }


def _limits(white: float) -> tuple[float, float]:
    return 0.0, white if white > 1e-6 else 1.0


def _stem(recording: Recording) -> str:
    return recording.path.name.split(".")[0] or recording.path.name
