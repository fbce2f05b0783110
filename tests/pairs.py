"""A small recording whose two views are known exactly: discs with a moving bar, and the calibration that fits."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import tifffile

from napari_elsplus.instrument.calibration import Calibration
from napari_elsplus.io import write_calibration

if TYPE_CHECKING:
    from pathlib import Path

SHAPE = (64, 128)
DIAMETER = 48
CONTENT = {
    "frame": {"shape": SHAPE},
    "offset": {"rows": -4.0, "uncertainty_rows": 0.02},
    "bundle": {
        "confocal_centre": [32.0, 31.0],
        "residual_centre": [30.0, 95.0],
        "diameter_px": DIAMETER,
        "residual_to_confocal": [[1.0, 0.0, 2.0], [0.0, 1.0, -64.0]],
    },
    "optics": {"um_per_px": 2.0, "line_period_s": 1e-5, "rows_per_frame": 400.0},
    "quality": {"alignment_error": 0.012, "alignment_error_filtered": 0.004},
}
FRAME_PERIOD_S = 4e-3


def frames(count: int = 6) -> np.ndarray:
    """Haze of 60 + 2 k in both views, a bar 100 brighter in the confocal one at row 20 + 3 k."""
    rows, cols = np.mgrid[: SHAPE[0], : SHAPE[1]]
    left = np.hypot(rows - 32, cols - 31) < DIAMETER / 2
    right = np.hypot(rows - 30, cols - 95) < DIAMETER / 2
    stack = np.empty((count, *SHAPE), np.uint8)
    for k, frame in enumerate(stack):
        frame[:] = (60 + 2 * k) * (left | right) + 100 * (left & (np.abs(rows - (20 + 3 * k)) < 2))
    return stack


def calibration() -> Calibration:
    return Calibration.parse(CONTENT)


def write_pair(folder: Path, count: int = 6, name: str = "scan") -> Path:
    """A recording with its calibration beside it."""
    path = folder / f"{name}.tif"
    tifffile.imwrite(path, frames(count), compression="zlib")
    write_calibration(folder / f"{name}.calibration.json", calibration())
    return path
