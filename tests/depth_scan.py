"""A scan of a plate's depth whose responses are known: the residual of this model dips below the background."""

from __future__ import annotations

import numpy as np

from napari_elsplus.instrument.calibration import Calibration

SHAPE = (300, 640)
DEPTH_UM = np.array([0.0, 10, 20, 30, 40, 60, 90, 150, 700])
PEDESTAL = 8000.0


def calibration() -> Calibration:
    content = {
        "frame": {"shape": SHAPE},
        "acquired_with": {"slit_rows": 2},
        "offset": {"rows": -10.0, "uncertainty_rows": 0.01},
        "bundle": {
            "confocal_centre": [150.0, 150.0],
            "residual_centre": [150.0, 480.0],
            "diameter_px": 280,
            "residual_to_confocal": [[1, 0, 0], [0, 1, -330]],
        },
        "optics": {"um_per_px": 2.0},
    }
    return Calibration.parse(content).model_copy(update={"background": np.full(SHAPE, PEDESTAL, np.float32)})


def frames() -> np.ndarray:
    """Left falls as 1 / (1 + z / 60), left minus right as 1 / (1 + (z / 30)^2)."""
    ls, els = 1 / (1 + DEPTH_UM / 60), 1 / (1 + (DEPTH_UM / 30) ** 2)
    stack = np.empty((len(DEPTH_UM), *SHAPE), np.uint16)
    stack[..., :320] = np.round(PEDESTAL + 40000 * ls)[:, None, None]
    stack[..., 320:] = np.round(PEDESTAL + 40000 * (ls - els))[:, None, None]
    return stack
