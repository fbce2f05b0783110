"""Contact sheet of a batch: one small picture for each recording."""

from __future__ import annotations

from math import ceil, sqrt
from typing import TYPE_CHECKING, Final

import numpy as np
from matplotlib.figure import Figure

from napari_elsplus.io import open_recording
from napari_elsplus.workflows.pictures.scale_bar import draw_scale_bar

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

MAX_SIDE: Final = 256
"""Pixels of a picture's longer side at most; chosen: a sheet of a hundred is then 3000 pixels wide."""
_BAR_PT: Final = 6.0
"""Size of the labels of scale bars, points; chosen: legible in print."""


def draw_batch_sheet(pictures: Sequence[tuple[str, Path]]) -> Figure:
    """Draw the middle image of each file with a scale bar, each between its own dark and bright levels.

    Parameters
    ----------
    pictures : sequence of (str, pathlib.Path)
        Name and file of each recording: a mosaic, or a stack of images.
    """
    columns = ceil(sqrt(len(pictures)))
    rows = ceil(len(pictures) / columns)
    figure = Figure(figsize=(2.2 * columns, 2.4 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for plot, (name, file) in zip(axes, pictures, strict=False):
        image, um_per_px = _small(file)
        seen = image[np.isfinite(image) & (image != 0)]
        low, high = np.quantile(seen, (0.01, 0.995)) if seen.size else (0.0, 1.0)
        plot.imshow(image, cmap="gray", vmin=low, vmax=high, interpolation="antialiased")
        plot.set_title(name, fontsize=7, y=1.0)  # a place of its own: searching one takes longer than drawing
        if um_per_px is not None:
            draw_scale_bar(plot, image.shape, um_per_px, _BAR_PT)
    for plot in axes:
        plot.set(xticks=[], yticks=[])
        plot.set_axis_off()
    return figure


def _small(file: Path) -> tuple[NDArray[np.float32], float | None]:
    """Return the middle image of a file, reduced, and its micrometres per pixel where they are known."""
    with open_recording(file) as stack:
        image, um_per_px = np.asarray(stack[len(stack) // 2], np.float32), stack.metadata.get("um_per_px")
    step = max(1, ceil(max(image.shape) / MAX_SIDE))
    return image[::step, ::step], None if um_per_px is None else step * um_per_px
