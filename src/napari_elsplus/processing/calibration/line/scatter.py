"""Scatter of a standing laser line from frame to frame: its shifts about a line that was fitted to their mean.

Each shift is one linear step of that fit, the light's change over its derivative by the row, since a whole fit of every
frame would take longer than that of their mean.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import cv2
import numpy as np

from napari_elsplus.processing.analysis.uncertainty import small_sample_factor
from napari_elsplus.processing.calibration.line.location import RUNS, TAPER, Line

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

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
    >>> round(float(LineShifts(mean, locate_line(mean)).shifts_rows(1.1 * lower).sum()), 2)
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
        self._runs = np.arange(len(columns)) * RUNS // len(columns)
        self._rest = self._by_run(band)

    def shifts_rows(self, view: NDArray[np.generic]) -> NDArray[np.float64]:
        """Return what each run of columns contributes to the rows by which the line lies below that of the mean.

        Parameters
        ----------
        view : numpy.ndarray
            (rows, cols) of a single frame.

        Returns
        -------
        numpy.ndarray
            (runs,); the sum is the shift of the line.
        """
        return np.asarray(self._by_run(view[self._part]) - self._rest, np.float64)

    def _by_run(self, band: NDArray[np.generic]) -> NDArray[np.float64]:
        by_column = np.einsum("ij,ij->j", self._weights, np.asarray(band, np.float32))
        return np.asarray(np.bincount(self._runs, by_column, RUNS), np.float64)


def relative_shifts(
    views: tuple[tuple[Line, slice], tuple[Line, slice]],
    mean: NDArray[Any],
    frames: Iterable[NDArray[np.generic]],
    background: Image | None = None,
) -> NDArray[np.float64]:
    """Return the shift of the second view's line less that of the first one's by frame and run of columns, rows.

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

    Returns
    -------
    numpy.ndarray
        Shape (frames, runs); the sum over the runs is the shift of the lines.
    """
    shifts = [
        (LineShifts(mean[:, part], line, None if background is None else background[:, part]), part)
        for line, part in views
    ]
    rows = np.array([[each.shifts_rows(frame[:, part]) for each, part in shifts] for frame in frames])
    return np.asarray(rows[:, 1] - rows[:, 0], np.float64)


def common_scatter_rows(shifts: NDArray[np.float64]) -> float:
    """Return the standard deviation of the mean of the frames' shifts by what their runs of columns have in common.

    Noise of single columns is in the residuals of the fit to the mean already; power noise of the laser is not. What
    the former adds up to by chance, one standard deviation of it, is not taken for the latter.

    Parameters
    ----------
    shifts : numpy.ndarray
        (frames, runs) of :func:`relative_shifts`; of few frames the variance is that of Student's t.

    Examples
    --------
    >>> round(common_scatter_rows(np.tile([[0.01], [-0.01]], (5, 32))), 2)
    0.12
    >>> common_scatter_rows(np.tile([[0.01, -0.01], [-0.01, 0.01]], (5, 16)))
    0.0
    """
    frames = len(shifts)
    together, apart = float(np.var(shifts.sum(axis=1), ddof=1)), float(np.var(shifts, axis=0, ddof=1).sum())
    by_chance = np.sqrt(2 / (frames - 1))  # relative standard deviation of a variance
    return small_sample_factor(frames - 1) * float(np.sqrt(max(together - (1 + by_chance) * apart, 0.0) / frames))
