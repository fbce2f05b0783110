"""Saturation of raw frames: the grey level at which a camera clips, and the note to the user where too much is lost."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

MAX_SATURATED_PIXELS: Final = 0.001
"""Share of the pixels of raw frames that may be saturated without a note; chosen, ten times the paper's 0.01 %."""
CAMERA_BITS: Final = range(8, 17)
"""Of a camera's grey levels, which may be fewer than those of its frames' dtype; chosen: those of cameras on sale."""
MIN_PILE_PX: Final = 10
"""Pixels at the largest level of a clipped frame; chosen: of fewer, no number that is measured suffers."""
PILE: Final = 2.0
"""Least ratio of the pixels at the largest level to those at the next one of a clipped frame; chosen: a histogram that
is not clipped falls towards its end, one that is clipped collects there whatever exceeds it."""


def saturation_note(share: float) -> str:
    """Return a message to the user, with the remedy, if a `share` of saturated pixels matters; else an empty one.

    Examples
    --------
    >>> saturation_note(0.12)
    '12.0 % of the pixels are saturated: lower the laser power or the gain'
    >>> saturation_note(1e-4), saturation_note(float("nan"))
    ('', '')
    """
    if not share > MAX_SATURATED_PIXELS:
        return ""
    return f"{100 * share:.1f} % of the pixels are saturated: lower the laser power or the gain"


def saturated_part(frame: NDArray[Any]) -> float:
    """Return the share, 0 to 1, of the pixels of a raw `frame` (rows, cols) that are saturated.

    Examples
    --------
    >>> saturated_part(np.array([[255, 255], [254, 3]], np.uint8))
    0.5
    """
    return float(np.count_nonzero(frame == saturation_level(frame)) / frame.size)


def saturation_level(frame: NDArray[Any]) -> float:
    """Return the grey level at which a frame is saturated: of the camera's bits where pixels pile up, or of the dtype.

    Parameters
    ----------
    frame : numpy.ndarray
        Raw frame (rows, cols), any real dtype; 10 to 14 bits in a container of 16 may be shifted to its left.

    Returns
    -------
    float
        Infinity for floats that do not pile up.

    Examples
    --------
    >>> ramp = np.arange(6000, dtype=np.uint16).reshape(60, 100)
    >>> saturation_level(ramp), saturation_level(np.minimum(ramp, 4095))
    (65535.0, 4095.0)
    """
    largest = largest_level(frame)
    if largest < 2**CAMERA_BITS.start:
        return largest
    top = float(np.max(frame, initial=0))
    ends = {2.0**bits - 1 for bits in CAMERA_BITS} | {2.0**16 - 2.0 ** (16 - bits) for bits in CAMERA_BITS}
    if top >= largest or top not in ends:
        return largest
    at_top = frame == top
    pile = np.count_nonzero(at_top)
    if pile < MIN_PILE_PX:
        return largest
    following = np.max(frame, where=~at_top, initial=0)
    return top if pile > PILE * np.count_nonzero(frame == following) else largest


def largest_level(frame: NDArray[Any]) -> float:
    """Return the largest grey level of a camera with integer pixels.

    Parameters
    ----------
    frame : numpy.ndarray
        Raw frame (rows, cols), whose dtype decides.
    """
    return _largest_level(frame.dtype)


@cache
def _largest_level(dtype: np.dtype[Any]) -> float:
    return float(np.iinfo(dtype).max) if np.issubdtype(dtype, np.integer) else float("inf")
