"""A calibration in a viewer: the outlines of the two bundle images, and a line that says how good it is."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.io import read_calibration
from napari_elsplus.viewing.layers import Opened
from napari_elsplus.viewing.stack import space

if TYPE_CHECKING:
    import os

    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import BundleSection, Calibration
    from napari_elsplus.viewing.layers import Layer

OUTLINE_COLOURS: Final = ("#56b4e9", "#e69f00")
"""Of the confocal and the residual outline: blue and orange, told apart by everyone."""


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
    note = f"{path.name} is the active calibration: {summary(calibration)}"
    if calibration.bundle is None:
        return Opened([], [note])
    return Opened([outline_layer(calibration, f"{path.name.removesuffix('.json')} bundle", path)], [note])


def outline_layer(calibration: Calibration, name: str, path: Path | None = None) -> Layer:
    """Outline the two bundle images of a calibration that knows them, as a shapes layer."""
    calibration.require("bundle")
    assert calibration.bundle is not None
    bundle = calibration.bundle
    attributes = space(calibration.um_per_px) | {"name": name}
    attributes |= {
        "shape_type": "ellipse",
        "edge_color": list(OUTLINE_COLOURS),
        "face_color": "transparent",
        "edge_width": max(1.0, bundle.diameter_px / 150),
        "features": {"view": ["confocal", "residual"]},
        "text": {"string": "{view}", "color": list(OUTLINE_COLOURS), "anchor": "upper_left", "size": 10},
        "metadata": {"elsplus": {"kind": "calibration", "calibration": calibration, "calibration_path": path}},
    }
    return _outlines(bundle), attributes, "shapes"


def summary(calibration: Calibration) -> str:
    """Say in a line what a calibration holds, and how good it is.

    Examples
    --------
    >>> from napari_elsplus.instrument.calibration import Calibration
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


def _outlines(bundle: BundleSection) -> list[NDArray[np.float64]]:
    radius = bundle.diameter_px / 2
    corners = radius * np.array([(-1, -1), (-1, 1), (1, 1), (1, -1)], np.float64)
    return [np.add(centre, corners) for centre in (bundle.confocal_centre, bundle.residual_centre)]
