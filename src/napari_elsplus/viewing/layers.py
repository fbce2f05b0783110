"""Recordings as layer data: lazy arrays with scale, units, names and provenance.

A layer is napari's tuple (data, attributes, type), plain data that needs no viewer.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from napari_elsplus.errors import ElsPlusError
from napari_elsplus.io import open_recording
from napari_elsplus.io.calibration_lookup import calibration_beside
from napari_elsplus.processing.analysis.image_quality import white_level
from napari_elsplus.processing.calibration.core_agreement import agreement_note
from napari_elsplus.processing.images.sectioning import Mode
from napari_elsplus.viewing.lazy import image_planes
from napari_elsplus.viewing.provenance import GIVES_WAY, PROVENANCE
from napari_elsplus.viewing.stack import Stack, attributes, images_origin_px, provenance

if TYPE_CHECKING:
    import os
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from napari_elsplus.instrument.calibration import Calibration

    Layer = tuple[Any, dict[str, Any], str]

SMOOTH: Final = "linear"
"""Interpolation of images: displayed below full resolution, the core pattern would alias (moire) with "nearest". Raw
frames keep "nearest", to show single pixels."""
GAP_PX: Final = 20
"""Columns between images that are displayed side by side; chosen, 6 % of an image at 240 Hz."""
TITLE_COLOUR: Final = "#8c8c8c"
"""Grey, legible on black and on white."""
TITLE_RISE: Final = 0.03
"""Distance of a title from its image, fraction of the image's rows; chosen."""
TITLE_PT: Final = 12
"""Size of a title, points; chosen."""
MOSAIC: Final = "mosaic"
"""Key of a mosaic's layers in their metadata."""


@dataclass(frozen=True)
class Opened:
    """Layers and messages that result from opening a file.

    Attributes
    ----------
    layers : list of tuple
        (data, attributes, type) each.
    notes : list of str
        Messages for the user: why there are no images, which calibration was used, or that it does not fit.
    """

    layers: list[Layer]
    notes: list[str]


def open_layers(path: str | os.PathLike[str], active: Path | None = None) -> Opened:
    """Open a recording as lazy layers: raw frames and, with a calibration, LS, residual, ELS+ and ELSA.

    Parameters
    ----------
    path : path-like
        Any recording that :func:`napari_elsplus.io.open_recording` opens.
    active : pathlib.Path, optional
        File of the active calibration, for a recording that has none in it or beside it.

    Returns
    -------
    Opened
        Only the first frame is loaded. If the calibration is broken or does not fit: the raw layer and a message.

    Raises
    ------
    InputError
        If the file is not a recording.
    """
    recording = open_recording(path)
    stack = Stack.of(recording)
    if recording.dtype.kind == "f":
        return Opened([finished_layer(stack)], [])
    notes = []
    try:
        calibration, source = recording.find_calibration(active)
        layers = [] if calibration is None else image_layers(stack, calibration, source)
        if calibration is not None and (note := agreement_note([stack.planes[0]], calibration)):
            notes.append(note)
        if source is not None and source == active and source != calibration_beside(recording.path):
            notes.append(f"{stack.file_name} is displayed with the active calibration, {source.name}")
    except ElsPlusError as error:
        calibration, source, layers = None, None, []
        notes.append(f"{stack.file_name} is displayed as raw frames only. {error}")
    raw = raw_layer(stack, calibration, source)
    raw[1]["visible"] = not layers
    layers.sort(key=lambda layer: bool(layer[1]["visible"]))  # napari selects the last, whose contrast is then set
    return Opened([raw, *layers], notes)


def raw_layer(stack: Stack, calibration: Calibration | None = None, source: Path | None = None) -> Layer:
    """Return the raw frames of a stack as a layer, with its calibration and the source file of that in the metadata."""
    words = attributes(stack, "raw", calibration)
    words["contrast_limits"] = _limits(float(stack.planes[0].max()))
    words["metadata"] = provenance(stack, "raw", calibration, source)
    return stack.planes.dask(), words, "image"


def image_layers(stack: Stack, calibration: Calibration, source: Path | None = None) -> list[Layer]:
    """Return LS, residual, ELS+ and, of a time series, ELSA layers at their place in the raw frame; ELS+ is visible.

    Parameters
    ----------
    stack : Stack
        Raw frames.
    calibration : Calibration
        Contains the bundle section.
    source : pathlib.Path, optional
        Its file, for the metadata.

    Raises
    ------
    CalibrationError
        If the calibration has no bundle or does not fit the frames.
    """
    origin_px = images_origin_px(calibration)
    layers: list[Layer] = []
    for mode in Mode:
        if mode is Mode.ELSA and (len(stack.planes) < mode.frames_per_image or stack.depth_um is not None):
            continue
        images = image_planes(stack.planes, calibration, mode)
        words = attributes(stack, mode.label, calibration, origin_px=origin_px)
        words["scale"] = (mode.frames_per_image * words["scale"][0], *words["scale"][1:])
        words["visible"] = mode is Mode.ELS
        words["interpolation2d"] = SMOOTH
        words["contrast_limits"] = _limits(white_level(images[0]))
        words["metadata"] = provenance(stack, mode.value, calibration, source)
        layers.append((images.dask(), words, "image"))
    return layers


def side_by_side(layers: list[Layer]) -> list[Layer]:
    """Return layers of images of one size placed side by side, all visible; they give way to what is opened later.

    Parameters
    ----------
    layers : list of tuple
        (data, attributes, type) each.

    Returns
    -------
    list of tuple
        Layers with the same data and new attributes.
    """
    placed = []
    for index, (data, words, kind) in enumerate(layers):
        step_um = words["scale"][-1]
        aside = index * (data.shape[-1] + GAP_PX) * step_um
        place = (*words["translate"][:-1], words["translate"][-1] + aside)
        facts = {**words["metadata"][PROVENANCE], GIVES_WAY: True}
        new = {"translate": place, "visible": True, "metadata": {**words["metadata"], PROVENANCE: facts}}
        placed.append((data, {**words, **new}, kind))
    return placed


def titles_layer(
    name: str,
    titles: Sequence[str],
    corners: Sequence[tuple[float, float]],
    place: Mapping[str, Any],
    colours: Sequence[str] = (),
) -> Layer:
    """Return a layer of text above images.

    Parameters
    ----------
    name : str
        Of the layer.
    titles : sequence of str
        One for each image.
    corners : sequence of tuple of float
        Row and column above which each begins, in pixels of the layer.
    place : mapping
        Scale, translation, units and labels of the two axes, as far as they differ from napari's defaults.
    colours : sequence of str, optional
        Of the titles, as hex.
    """
    colour = list(colours) or TITLE_COLOUR
    text = {"string": "{title}", "color": colour, "size": TITLE_PT, "anchor": "upper_left"}
    words = {"name": name, "size": 1, "face_color": "transparent", "border_color": "transparent", "text": text}
    words["features"] = {"title": list(titles)}
    return np.array(corners, np.float64).reshape(-1, 2), {**words, "visible": True, **place}, "points"


def titles_above(name: str, layers: Sequence[Layer], titles: Sequence[str]) -> Layer:
    """Return a layer of titles above layers of images.

    Parameters
    ----------
    name : str
        Of the layer.
    layers : sequence of tuple
        (data, attributes, type) each, of one scale.
    titles : sequence of str
        One for each.
    """
    first = layers[0][1]
    step, rise = first["scale"][-1], TITLE_RISE * layers[0][0].shape[-2]
    places = [words["translate"] for _, words, _ in layers]
    corners = [(place[-2] / step - rise, place[-1] / step) for place in places]
    place = {key: first[key][-2:] for key in ("scale", "units", "axis_labels")}
    place["metadata"] = {PROVENANCE: {"kind": "titles", GIVES_WAY: True}}
    return titles_layer(name, titles, corners, place)


def finished_layer(stack: Stack) -> Layer:
    """Return processed images of a stack as a layer; a single image (a mosaic) has neither time nor depth axis."""
    settings = stack.metadata.get("settings")
    mode = settings.get("mode") if isinstance(settings, dict) else None
    title = next((known.label for known in Mode if known.value == mode), "images")
    words = attributes(stack, title, None)
    words["contrast_limits"] = _limits(white_level(stack.planes[0]))
    words["interpolation2d"] = SMOOTH
    words["metadata"] = provenance(stack, str(mode or "images"), stack.own_calibration(), None)
    if len(stack.planes) == 1:
        flat = {name: words[name][1:] for name in ("scale", "translate", "units", "axis_labels")}
        return stack.planes[0], words | flat, "image"
    return stack.planes.dask(), words, "image"


def _limits(white: float) -> tuple[float, float]:
    return 0.0, white if white > 1e-6 else 1.0
