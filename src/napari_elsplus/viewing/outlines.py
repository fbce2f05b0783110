"""A calibration as layer data: outlines of the two bundle images, and a one-line summary of its accuracy."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.io import read_calibration
from napari_elsplus.processing.calibration.summaries import with_uncertainty
from napari_elsplus.viewing.layers import Opened
from napari_elsplus.viewing.provenance import PROVENANCE
from napari_elsplus.viewing.stack import space

if TYPE_CHECKING:
    import os

    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.viewing.layers import Layer

OUTLINE_COLOURS: Final = ("#56b4e9", "#e69f00")
"""Colours of the confocal and the residual outline: blue and orange of Okabe and Ito, colour-blind safe."""


def calibration_layers(path: str | os.PathLike[str]) -> Opened:
    """Return a calibration as a layer: outlines of the two bundle images, in pixels of the raw frame or micrometres.

    Parameters
    ----------
    path : path-like
        A calibration's JSON file.

    Returns
    -------
    Opened
        A shapes layer if the bundle was located, and a summary of the calibration.

    Raises
    ------
    CalibrationError
        If it is broken.
    """
    path = Path(path)
    calibration = read_calibration(path)
    note = f"{path.name} is now the active calibration: {summary(calibration)}"
    if calibration.bundle is None:
        return Opened([], [note])
    return Opened([outline_layer(calibration, f"{path.name.removesuffix('.json')} bundle", path)], [note])


def outline_layer(calibration: Calibration, name: str, path: Path | None = None) -> Layer:
    """Return the outlines of the two bundle images of a calibration as a shapes layer.

    Parameters
    ----------
    calibration : Calibration
        Contains the bundle section.
    name : str
        Name of the layer.
    path : pathlib.Path, optional
        The calibration's file, for the metadata.
    """
    bundle = calibration.measured_bundle
    attributes = space(calibration.um_per_px) | {"name": name}
    attributes |= {
        "shape_type": "ellipse",
        "edge_color": list(OUTLINE_COLOURS),
        "face_color": "transparent",
        "edge_width": max(1.0, bundle.diameter_px / 150),
        "features": {"view": ["confocal", "residual"]},
        "text": {"string": "{view}", "color": list(OUTLINE_COLOURS), "anchor": "upper_left", "size": 10},
        "metadata": {PROVENANCE: {"kind": "calibration", "calibration": calibration, "calibration_path": path}},
    }
    corners = np.array([(-1, -1), (-1, 1), (1, 1), (1, -1)], np.float64)
    return [np.add(centre, diameter_px / 2 * corners) for centre, diameter_px in bundle.discs], attributes, "shapes"


def summary(calibration: Calibration) -> str:
    """Return a one-line summary of a calibration's sections and their accuracy.

    Examples
    --------
    >>> from napari_elsplus.instrument.calibration import Calibration
    >>> summary(Calibration.parse({"offset": {"rows": -12.03, "uncertainty_rows": 0.01}}))
    'slit offset -12.03 ± 0.01 rows'
    """
    parts = []
    if calibration.offset is not None:
        offset = with_uncertainty(calibration.offset.rows, calibration.offset.uncertainty_rows)
        parts.append(f"slit offset {offset} rows")
    if calibration.bundle is not None:
        parts.append(f"bundle {calibration.bundle.diameter_px:.1f} px wide")
    if calibration.galvo is not None:
        parts.append(f"galvo {1e3 * calibration.galvo.volts_per_row:.3f} mV per row")
    if calibration.quality is not None:
        parts.append(f"alignment error {100 * calibration.quality.alignment_error:.1f} %")
    if calibration.background is not None:
        parts.append("background")
    return ", ".join(parts) or "no measured section"
