"""Saturation of a laser line: the part of its core that the camera clips, in a frame that is hardly saturated."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from napari_elsplus.processing.calibration.line.view_offset import IN_PLACE, ViewOffset

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.processing.calibration.line.location import Line

MAX_CLIPPED_CORE: Final = 0.01
"""Largest saturated part of a line's core; measured on a plain model: with 0.01 to 0.02 the gain of the residual view
is off by 0.0004, of which 0.0002 are stated, with 0.15 by 0.005. Hot pixels stay below."""


def clipped_share(frame: NDArray[Any], white: float, line: Line, view_offset: ViewOffset = IN_PLACE) -> float:
    """Return the saturated part of the pixels within one standard deviation of a line.

    Parameters
    ----------
    frame : numpy.ndarray
        Raw frame (rows, cols).
    white : float
        Grey level at which it is saturated.
    line : Line
        In the confocal view.
    view_offset : ViewOffset
        From that line to the one whose pixels are counted.

    Examples
    --------
    >>> from napari_elsplus.processing.calibration.line.location import locate_line
    >>> line = 100 * np.exp(-(np.square(np.arange(80)[:, None] - 31) / 18)) + np.zeros(120)
    >>> clipped = np.minimum(3 * line, 255)
    >>> clipped_share(line, 255, locate_line(line)), clipped_share(clipped, 255, locate_line(clipped))
    (0.0, 0.43)
    """
    down, across, turn, _ = view_offset
    columns = np.arange(*line.columns)
    along, reach = columns - line.column, max(round(line.width_rows), 1)
    middle = line.row + down - line.bow * line.mean_square_px + (line.slope + turn + line.bow * along) * along
    rows = np.rint(middle).astype(int) + np.arange(-reach, reach + 1)[:, None]
    cols = np.broadcast_to(columns + round(across), rows.shape)
    inside = (rows >= 0) & (rows < frame.shape[0]) & (cols >= 0) & (cols < frame.shape[1])
    return float(np.mean(frame[rows[inside], cols[inside]] >= white)) if inside.any() else 0.0
