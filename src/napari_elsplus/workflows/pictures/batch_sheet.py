"""Contact sheet of a batch: one small picture for each recording."""

from __future__ import annotations

from math import ceil, sqrt
from typing import TYPE_CHECKING, Final

import numpy as np
from matplotlib.figure import Figure

from napari_elsplus.workflows.pictures.scale_bar import draw_scale_bar

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

_GAP_PX: Final = 12
"""Space between pictures, pixels; chosen."""
_NAME_PX: Final = 20
"""Height of a name, pixels; chosen: that of the letters, and a margin."""
_NAME_PT: Final = 7.0
"""Size of the names, points; chosen: legible in print."""
_BAR_PT: Final = 6.0
"""Size of the labels of scale bars, points; chosen: legible in print."""
_PX_PER_INCH: Final = 120
"""Resolution of the sheet: a pixel of a picture is a pixel of the sheet when it is saved."""


def draw_batch_sheet(pictures: Sequence[tuple[str, NDArray[np.uint8], float | None]]) -> Figure:
    """Draw small pictures with their names and scale bars, side by side on one pair of axes.

    Parameters
    ----------
    pictures : sequence of (str, numpy.ndarray, float or None)
        Name, picture (rows, cols) of 8 bit, and micrometres per pixel where they are known.
    """
    columns = ceil(sqrt(len(pictures)))
    rows = ceil(len(pictures) / columns)
    high, wide = (max(picture.shape[axis] for _, picture, _ in pictures) for axis in (0, 1))
    cell_rows, cell_cols = high + _NAME_PX + _GAP_PX, wide + _GAP_PX
    sheet = np.full((rows * cell_rows, columns * cell_cols), 255, np.uint8)
    figure = Figure(figsize=(sheet.shape[1] / _PX_PER_INCH, sheet.shape[0] / _PX_PER_INCH), dpi=_PX_PER_INCH)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    for place, (name, picture, um_per_px) in enumerate(pictures):
        height, width = picture.shape
        top = (place // columns) * cell_rows + _NAME_PX
        left = (place % columns) * cell_cols + (cell_cols - width) // 2
        sheet[top : top + height, left : left + width] = picture
        axes.text(left + width / 2, top - 4, name, ha="center", va="bottom", fontsize=_NAME_PT)
        if um_per_px is not None:
            draw_scale_bar(axes, picture.shape, um_per_px, _BAR_PT, corner=(top, left))
    axes.imshow(sheet, cmap="gray", vmin=0, vmax=255, interpolation="nearest")
    axes.set_axis_off()
    return figure
