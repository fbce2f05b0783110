"""Jumps of the line within a sweep: where a frame was lost, all later lines stand on the rows of other voltages.

They would seem to be a curved galvo, or outliers, and the map is wrong by up to a step of the sweep.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.errors import MeasurementError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

LEFT_OVER: Final = 0.5
"""Of the squares that a curve leaves over, which a jump leaves at most; measured, of sweeps of 60 to 400 voltages of 15
random rigs: 0.87 and more in steady ones, 0.18 at most in those that lost a frame."""
MIN_JUMP_ROWS: Final = 0.2
"""Smallest jump; chosen: it moves the map by half of it at most, less than a tenth of the paper's slit."""
MAX_PART: Final = 0.25
"""Of a step of the sweep, by which a jump differs at most from a whole number of them; chosen: a galvo whose way back
lies beside the way there, by any other distance, lost no frame: its mean is right."""
MIN_JUMP_SIGMAS: Final = 4.0
"""The same in standard deviations of what it leaves over; chosen: a single line that is off does not reach it."""
MIN_SIDE: Final = 4
"""Voltages before and after a jump; chosen: fewer are outliers."""


def require_steady(rows: Floats, curve: Floats, frames: NDArray[np.intp]) -> None:
    """Refuse a sweep in which the line jumps at a frame and stays displaced.

    Parameters
    ----------
    rows : numpy.ndarray
        Row of the line in one frame after the other, shape (lines,).
    curve : numpy.ndarray
        Terms of a curved map at its voltages, shape (lines, terms), of which the first two are those of a straight one.
    frames : numpy.ndarray
        Number of each frame in the sweep, rising.

    Raises
    ------
    MeasurementError
        If a straight map with a jump by whole steps of the sweep describes it far better than a curved map.
    """
    new = np.flatnonzero(np.any(np.diff(curve, axis=0, prepend=np.inf) != 0, axis=1))  # voltages, with errors in common
    rows, curve, frames = np.add.reduceat(rows, new) / np.diff(new, append=len(rows)), curve[new], frames[new]
    count = len(rows)
    if count < 2 * MIN_SIDE + curve.shape[1]:
        return
    base = np.linalg.qr(curve[:, :2])[0]
    away = rows - base @ (base.T @ rows)
    after = np.cumsum(away[::-1])[::-1]  # product of what the line leaves over with each jump of one row
    squares = np.arange(count, 0, -1) - np.square(np.cumsum(base[::-1], axis=0)[::-1]).sum(axis=1)
    explained = (np.square(after) / np.maximum(squares, 1e-9))[MIN_SIDE : count - MIN_SIDE + 1]
    first = int(np.argmax(explained)) + MIN_SIDE
    jump_rows, left_over = after[first] / squares[first], np.square(away).sum() - explained.max()
    of_curve = np.square(rows - curve @ np.linalg.lstsq(curve, rows, rcond=None)[0]).sum()
    sigma_rows = np.sqrt(max(left_over, 0.0) / count)
    steps = abs(jump_rows) / max(float(np.median(np.abs(np.diff(rows)))), MIN_JUMP_ROWS)
    if abs(steps - max(round(steps), 1)) > MAX_PART:
        return
    if left_over < LEFT_OVER * of_curve and abs(jump_rows) > max(MIN_JUMP_ROWS, MIN_JUMP_SIGMAS * sigma_rows):
        raise MeasurementError(
            f"the line jumps by {jump_rows:.2g} rows at frame {frames[first]} of the sweep",
            "was a frame lost? Record the sweep again",
        )
