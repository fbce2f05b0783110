"""napari's sample data: what the simulated instrument shows."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from napari_elsplus import __version__
from napari_elsplus.pipeline import images
from napari_elsplus.processing.sectioning import Mode
from napari_elsplus.simulation import calibration_scenes
from napari_elsplus.simulation.instrument import Instrument
from napari_elsplus.simulation.renderer import Renderer
from napari_elsplus.simulation.scenes import scene
from napari_elsplus.simulation.trajectories import trajectory
from napari_elsplus.simulation.truth import true_calibration

LayerData = tuple[NDArray[np.float32], dict[str, Any], str]

FRAMES: Final = 24
GAP_PX: Final = 20
"""Dark columns between the images that stand side by side."""
NAMES: Final = {Mode.LS: "LS", Mode.RESIDUAL: "residual", Mode.ELS: "ELS+"}


def recording() -> list[LayerData]:
    """Record a hand-held probe over fibres at 240 Hz and section it: LS, residual and ELS+ side by side.

    Returns
    -------
    list of tuple
        For each image its stack (T, n, n) in grey levels, its layer's settings (in micrometres, with the
        calibration), and ``"image"``.
    """
    instrument = Instrument.of("240hz")
    renderer = Renderer(instrument, scene("fibres"), trajectory("hand"))
    raw = np.stack([renderer.render(index) for index in range(FRAMES)])
    calibration = true_calibration(instrument, calibration_scenes.background(instrument))
    stacks = {mode: np.stack(list(images(raw, calibration, mode))) for mode in NAMES}
    brightest = float(np.percentile(stacks[Mode.LS], 99.9))
    um_per_px = instrument.optics.um_per_px
    layers: list[LayerData] = []
    for place, (mode, stack) in enumerate(stacks.items()):
        settings = {
            "name": NAMES[mode],
            "scale": (1, um_per_px, um_per_px),
            "translate": (0, 0, place * (stack.shape[2] + GAP_PX) * um_per_px),
            "units": ("pixel", "um", "um"),
            "axis_labels": ("frame", "row", "column"),
            "contrast_limits": (0, brightest),
            "metadata": {"software": f"napari-elsplus {__version__}", "calibration": calibration.content()},
        }
        layers.append((stack, settings, "image"))
    return layers
