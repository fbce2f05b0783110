"""Scatter of a standing laser line from frame to frame: its shifts about a line that was fitted to their mean.

Each shift is one linear step of that fit, the light's change over its derivative by the row, since a whole fit of every
frame would take longer than that of their mean.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import cv2
import numpy as np

from napari_elsplus.processing.calibration.line.location import TAPER

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from napari_elsplus.processing.calibration.line.location import Line

    Image = NDArray[np.float32]

REACH: Final = 4.0
"""Standard deviations of the smoothed profile to which the line is compared; chosen: the taper leaves nothing."""


class LineShifts:
    """Shifts of single frames' lines about the line of their mean.

    Parameters
    ----------
    mean : numpy.ndarray
        (rows, cols) view, mean of the frames.
    line : Line
        As located in it, without the background.
    background : numpy.ndarray, optional
        (rows, cols) mean frame of the dark tube, which the frames contain.

    Notes
    -----
    Changes of brightness, level and slope of the background do not shift the line, as in the fit itself.

    Examples
    --------
    >>> from napari_elsplus.processing.calibration.line.location import locate_line
    >>> rows = np.arange(80)[:, None] - 31.25 + 0 * np.arange(120)
    >>> mean, lower = (np.float32(100 * np.exp(-((rows - by) ** 2) / 8)) for by in (0, 0.1))
    >>> round(float(LineShifts(mean, locate_line(mean)).shift_rows(1.1 * lower)), 2)
    0.11
    """

    def __init__(self, mean: NDArray[Any], line: Line, background: Image | None = None) -> None:
        width = np.float32(np.sqrt(2) * line.width_rows)  # as smoothed for the fit
        columns = np.arange(*line.columns)
        at = (line.row + line.slope * (columns - line.column)).astype(np.float32)
        first = max(int(at.min() - REACH * width), 0)
        self._part = slice(first, int(at.max() + REACH * width) + 2), slice(*line.columns)
        band = mean[self._part]
        z = (np.arange(first, first + len(band), dtype=np.float32)[:, None] - at) / width
        bell, taper = np.exp(-0.5 * z * z), np.exp(-0.5 * np.square(z / np.float32(TAPER)))
        odd = bell * z
        odd -= z * ((taper * odd * z).sum() / max(float((taper * z * z).sum()), 1e-9))  # of the ramp's part
        ramp = np.float32(line.ramp) * (z * width)
        light = band if background is None else band - background[self._part]
        by_row = (light - np.float32(line.level) - ramp) * z * width / np.float32(line.width_rows**2)
        size = 2 * round(3 * line.width_rows) + 1
        self._weights = cv2.GaussianBlur(taper * odd, (1, size), line.width_rows, borderType=cv2.BORDER_REFLECT)
        self._weights /= max(float((self._weights * by_row).sum()), 1e-9)
        self._rest = float((self._weights * band).sum())

    def shift_rows(self, view: NDArray[np.generic]) -> float:
        """Return the rows by which the line of a single frame's view (rows, cols) lies below that of the mean."""
        return float((self._weights * np.asarray(view[self._part], np.float32)).sum()) - self._rest


def relative_shifts(
    views: tuple[tuple[Line, slice], tuple[Line, slice]],
    mean: NDArray[Any],
    frames: Iterable[NDArray[np.generic]],
    background: Image | None = None,
) -> NDArray[np.float64]:
    """Return the shift of the second view's line less that of the first one's in each frame, rows, shape (frames,).

    Parameters
    ----------
    views : tuple
        Line of each view, and the view's columns of the frame.
    mean : numpy.ndarray
        (rows, cols) mean of the frames.
    frames : iterable of numpy.ndarray
        Single frames (rows, cols).
    background : numpy.ndarray, optional
        (rows, cols) mean frame of the dark tube, which the frames contain.
    """
    shifts = [
        (LineShifts(mean[:, part], line, None if background is None else background[:, part]), part)
        for line, part in views
    ]
    rows = np.array([[each.shift_rows(frame[:, part]) for each, part in shifts] for frame in frames])
    return np.asarray(rows[:, 1] - rows[:, 0], np.float64)
