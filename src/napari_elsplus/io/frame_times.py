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


def median_period_s(times_s: Sequence[float] | NDArray[np.float64]) -> float | None:
    """Return the period of frames, seconds: the median step of their times, which lost frames do not change.

    Parameters
    ----------
    times_s : sequence of float
        (T,) time of each frame, seconds.

    Returns
    -------
    float or None
        None of fewer than two frames, and where the clock does not advance.

    Examples
    --------
    >>> median_period_s([0.0, 0.25, 0.5, 1.25])
    0.25
    """
    steps = np.diff(np.asarray(times_s, np.float64))
    return positive(np.median(steps)) if len(steps) else None


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
