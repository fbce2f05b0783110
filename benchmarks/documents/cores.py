"""Picture of frames of a photographed bundle made finer than its cores: ``python3 run.py bench bundle-frames``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from matplotlib.figure import Figure

from benchmarks.rigs.bundle_frames import BundleFrames, bundle_frames
from napari_elsplus.workflows.core_mosaicing.views import FinishedBundle
from napari_elsplus.workflows.mosaicing import MosaicResult, mosaic

if TYPE_CHECKING:
    from numpy.typing import NDArray

FRAMES: Final = 12
REACH_PX: Final = 20.0
_SHOWN: Final = 100.0
"""Side of the part that is drawn, core pitches."""


def draw_bundle_frames(flat: NDArray[np.float32]) -> tuple[Figure, dict[str, float]]:
    """Return the picture, and the largest errors of the displacements, px, with the flat field and without it.

    Parameters
    ----------
    flat : numpy.ndarray
        (rows, cols) photograph of an evenly lit bundle.
    """
    made = bundle_frames(flat, FRAMES, REACH_PX)
    results = {
        "with the flat field": mosaic(made.frames, finished=True, insertion="cores", flat=made.flat),
        "without": mosaic(made.frames, finished=True, insertion="cores"),
    }
    bundle = FinishedBundle(made.frames, made.flat)
    one, per_pitch = bundle[0], made.pitch_px
    pictures = {
        "one frame": (bundle.view.image(made.frames[0], made.frames[0]), bundle.view.centre, per_pitch),
        "one frame, interpolated between cores": (one, bundle.view.centre, per_pitch),
        **{
            f"{FRAMES} frames core by core, {name}": (result.image, result.first_frame_px, 4.0)
            for name, result in results.items()
        },
    }
    figure = Figure(figsize=(13, 12.6), layout="constrained")
    for axes, (title, (image, centre, px)) in zip(figure.subplots(2, 2).ravel(), pictures.items(), strict=True):
        half = int(0.5 * _SHOWN * px)
        row, col = (int(c) for c in centre)
        part = image[max(row - half, 0) : row + half, max(col - half, 0) : col + half]
        axes.imshow(part, cmap="gray", vmin=0, vmax=np.percentile(part, 99))
        axes.set_title(title)
        axes.set_axis_off()
    return figure, {name: _error_px(made, result) for name, result in results.items()}


def _error_px(made: BundleFrames, result: MosaicResult) -> float:
    found = np.array([(row.row_px, row.col_px) for row in result.track])
    return float(np.hypot(*(found - made.displacements_px).T).max())
