"""Picture of a mosaic for slides and papers, with a scale bar."""

from __future__ import annotations

from math import ceil
from typing import TYPE_CHECKING, Final

import cv2
from matplotlib.figure import Figure

from napari_elsplus.workflows.pictures.files import DPI
from napari_elsplus.workflows.pictures.scale_bar import draw_scale_bar

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

MAX_SIDE_PX: Final = 4000
"""Pixels of the longer side of the picture; larger mosaics are reduced by area averaging. Chosen for viewers."""
_MIN_SIDE_PX: Final = 300
"""Pixels of the shorter side below which pixels are repeated, so that the scale bar can be read. Chosen."""


def draw_mosaic(image: NDArray[np.float32], um_per_px: float | None, white: float) -> Figure:
    """Draw a mosaic, one pixel of the saved picture for each of its own up to :data:`MAX_SIDE_PX`.

    Parameters
    ----------
    image : numpy.ndarray
        (rows, cols) grey levels.
    um_per_px : float or None
        Micrometres per pixel; without it there is no scale bar.
    white : float
        Grey level that is drawn as white.
    """
    shrink = max(1, ceil(max(image.shape) / MAX_SIDE_PX))
    rows, cols = (max(1, length // shrink) for length in image.shape)
    small = cv2.resize(image, (cols, rows), interpolation=cv2.INTER_AREA) if shrink > 1 else image
    grow = max(1, ceil(_MIN_SIDE_PX / min(rows, cols)))
    figure = Figure(figsize=(cols * grow / DPI, rows * grow / DPI), facecolor="black")
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_axis_off()
    axes.imshow(small, cmap="gray", vmin=0, vmax=white, interpolation="nearest", aspect="auto")
    if um_per_px is not None:
        font_pt = max(8.0, 0.03 * min(rows, cols) * grow * 72 / DPI)
        draw_scale_bar(axes, small.shape, um_per_px * shrink, font_pt)
    return figure
