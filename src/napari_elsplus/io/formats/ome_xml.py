"""OME-XML: metadata of a stack to the XML of its file, and back."""

from __future__ import annotations

import json
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Final
from xml.etree import ElementTree

from napari_elsplus import __version__
from napari_elsplus.instrument.calibration import FORMAT
from napari_elsplus.io.calibrations import format_calibration
from napari_elsplus.io.formats.source import positive

if TYPE_CHECKING:
    from pathlib import Path

    import numpy as np

    from napari_elsplus.io.formats.registry import ImageMetadata

SOFTWARE: Final = f"napari-elsplus {__version__}"
"""Written as the creator of every file."""
SETTINGS: Final = "napari-elsplus/settings"
"""Namespace of the annotation that keeps settings as JSON."""
_UM: Final = {"µm": 1.0, "μm": 1.0, "um": 1.0, "micron": 1.0, "nm": 1e-3, "mm": 1e3, "m": 1e6}
TO_S: Final = {"s": 1.0, "ms": 1e-3, "µs": 1e-6, "μs": 1e-6, "us": 1e-6, "min": 60.0}
"""Micrometres and seconds in the units of OME-XML."""


def tifffile_metadata(metadata: ImageMetadata, *, single: bool = False) -> dict[str, Any]:
    """Return the metadata of a stack, or of a single image, under the keys of tifffile's OME metadata.

    Parameters
    ----------
    metadata : ImageMetadata
        Calibration and settings are kept as annotations.
    single : bool
        True for a single image; like a scan of depths it has neither a frame interval nor times.
    """
    axes = "YX" if single else "ZYX" if metadata.depth_scan else "TYX"
    fields: dict[str, Any] = {"Description": SOFTWARE, "axes": axes}
    if metadata.um_per_px is not None:
        fields |= {"PhysicalSizeX": metadata.um_per_px, "PhysicalSizeY": metadata.um_per_px}
        fields |= {"PhysicalSizeXUnit": "µm", "PhysicalSizeYUnit": "µm"}
    if metadata.frame_period_s is not None and axes == "TYX":
        fields |= {"TimeIncrement": metadata.frame_period_s, "TimeIncrementUnit": "s"}
    if metadata.times_s is not None and axes == "TYX":
        fields["Plane"] = {"DeltaT": list(metadata.times_s), "DeltaTUnit": ["s"] * len(metadata.times_s)}
    notes = []
    if metadata.calibration is not None:
        notes.append({"Namespace": FORMAT, "Value": format_calibration(metadata.calibration)})
    if metadata.settings:
        notes.append({"Namespace": SETTINGS, "Value": json.dumps(dict(metadata.settings), default=str)})
    if notes:
        fields["CommentAnnotation"] = notes
    return fields


def put_into_first_page(
    path: Path,
    shape: tuple[int, int, int],
    dtype: np.dtype[Any],
    metadata: ImageMetadata,
) -> None:
    """Write the OME-XML of a finished TIFF of one page per frame over the first page's description.

    Parameters
    ----------
    path : pathlib.Path
        The file; its first page has a description.
    shape : tuple of int
        (T, rows, cols).
    dtype : numpy.dtype
        Of the frames.
    metadata
        As :func:`tifffile_metadata`.
    """
    import tifffile

    count, rows, cols = shape
    xml = tifffile.OmeXml(creator=SOFTWARE)
    fields = tifffile_metadata(metadata)
    xml.addimage(dtype.name, shape, (count, 1, 1, rows, cols, 1), **fields)
    with tifffile.TiffFile(path, mode="r+") as file:
        file.pages.first.tags["ImageDescription"].overwrite(xml.tostring(declaration=True).encode(), erase=False)


def parse(xml: str) -> dict[str, Any]:
    """Return the metadata of the first image of an OME-XML document; invalid values are left out."""
    metadata: dict[str, Any] = {}
    try:
        root = ElementTree.fromstring(xml.encode())
    except ElementTree.ParseError:
        return metadata
    pixels = root.find("{*}Image/{*}Pixels")
    if pixels is None:
        return metadata
    scale = _UM.get(pixels.get("PhysicalSizeXUnit", "µm"))
    if scale and (size := positive(pixels.get("PhysicalSizeX"))):
        metadata["um_per_px"] = size * scale
    scale = TO_S.get(pixels.get("TimeIncrementUnit", "s"))
    if scale and (period := positive(pixels.get("TimeIncrement"))):
        metadata["frame_period_s"] = period * scale
    metadata["times_s"] = [_delta_s(plane) for plane in sorted(pixels.iterfind("{*}Plane"), key=_plane_place)]
    return metadata | _annotations(root)


def _plane_place(plane: ElementTree.Element) -> tuple[int, ...]:
    """Return time, plane and channel of a plane of a stack: the order of a document's planes has no meaning."""
    try:
        return tuple(int(plane.get(axis, "0")) for axis in ("TheT", "TheZ", "TheC"))
    except ValueError:
        return (0,)


def _delta_s(plane: ElementTree.Element) -> float | None:
    try:
        return float(plane.get("DeltaT", "nan")) * TO_S.get(plane.get("DeltaTUnit", "s"), float("nan"))
    except ValueError:
        return None


def _annotations(root: ElementTree.Element) -> dict[str, Any]:
    metadata: dict[str, Any] = {}
    for note in root.iterfind("{*}StructuredAnnotations/{*}CommentAnnotation"):
        name = {FORMAT: "calibration", SETTINGS: "settings"}.get(note.get("Namespace", ""))
        text = note.findtext("{*}Value")
        if name is not None and text is not None:
            with suppress(ValueError, RecursionError):
                metadata[name] = text if name == "calibration" else json.loads(text)
    return metadata
