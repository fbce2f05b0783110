"""Times of frames: the period that they have, and which of them the period alone does not give."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.io.formats.source import positive

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

MAX_UNEVENNESS: Final = 0.01
"""Departure from the times that the period alone gives, fraction of it, up to which they are even. Chosen: a camera's
clock is finer, and a lost frame is a hundred times as much."""


def median_period_s(
    times_s: Sequence[float] | NDArray[np.float64], frame_numbers: Sequence[int] | NDArray[np.int64] | None = None
) -> float | None:
    """Return the period of a camera, seconds: the median of time over number from frame to frame.

    Lost frames do not change it: they are gaps in the numbers. A camera that was started again counts from 0, and that
    step is left out.

    Parameters
    ----------
    times_s : sequence of float
        (T,) time of each frame, seconds.
    frame_numbers : sequence of int, optional
        (T,) the camera's number of each frame; by default none were lost.

    Returns
    -------
    float or None
        None of fewer than two frames, and where the clock or the numbers do not advance.

    Examples
    --------
    >>> median_period_s([0.0, 0.25, 0.5, 1.25])
    0.25
    >>> median_period_s([0.0, 0.5, 1.25], [0, 2, 5])
    0.25
    """
    steps_s = np.diff(np.asarray(times_s, np.float64))
    passed = np.ones_like(steps_s) if frame_numbers is None else np.diff(np.asarray(frame_numbers))
    counted = passed > 0
    return positive(np.median(steps_s[counted] / passed[counted])) if counted.any() else None


def uneven_times_s(times_s: NDArray[np.float64] | None, period_s: float | None) -> tuple[float, ...] | None:
    """Return the times of frames where their period alone does not give them; None where it does.

    Parameters
    ----------
    times_s : numpy.ndarray or None
        (T,) time of each frame, seconds.
    period_s : float or None
        Their period; the first of frames that are even is at 0.

    Examples
    --------
    >>> uneven_times_s(np.array([0.0, 0.25, 0.75]), 0.25)
    (0.0, 0.25, 0.75)
    >>> uneven_times_s(np.array([0.0, 0.25, 0.5]), 0.25)
    """
    if times_s is None or not np.isfinite(times_s).all():
        return None
    if period_s is not None and (abs(times_s - np.arange(len(times_s)) * period_s) <= MAX_UNEVENNESS * period_s).all():
        return None
    return tuple(times_s.tolist())
