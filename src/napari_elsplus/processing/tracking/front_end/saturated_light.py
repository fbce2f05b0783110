"""Light that saturated pixels did not show, from the pixels around them.

Saturated cores are alike in all frames: divided by the flat field their pattern stands still, and competes with the
specimen. A pixel is therefore estimated from the unsaturated ones around it, each compared with the light by which the
dark tube's background shows the same cores.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import cv2
import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

MIN_LEVEL: Final = 0.01
"""Least mean of the background's light in the view, as a share of the range of grey levels; chosen: below it noise
would be taken for the pattern of the cores."""
MAX_BEYOND: Final = 4.0
"""Largest light beyond saturation that is estimated, in the range of grey levels; chosen, so that a level of 255 is two
hundredths of that."""
_MIN_SEEN: Final = 0.5
"""Least light that the background has in the unsaturated pixels together, in its mean in the view; chosen."""


class SaturatedLight:
    """Estimates light beyond saturation in frames of one camera region.

    Parameters
    ----------
    background : numpy.ndarray
        (rows, cols) float32 mean frame of the dark tube, grey levels, without hot pixels.
    black : float
        Its level where there is no light.
    level : float
        Its mean level in the view.
    reach : int
        Distance, rows and columns, of the farthest pixels by which one is estimated.
    """

    def __init__(self, background: NDArray[np.float32], black: float, level: float, reach: int) -> None:
        self._pattern = np.maximum(background - np.float32(black), 0)
        self._black, self._level, self._reach = black, level - black, reach

    def known(self, limit: float) -> bool:
        """Return True if the background shows the cores; `limit` is the grey level of saturated pixels."""
        return self._level > MIN_LEVEL * (limit - self._black)

    def beyond(self, frame: NDArray[Any], limit: float) -> tuple[NDArray[Any], float]:
        """Return by how much the light of saturated pixels exceeds them, (rows, cols) like the frame; and its unit.

        Parameters
        ----------
        frame : numpy.ndarray
            (rows, cols) raw frame, of an integer type or float32.
        limit : float
            Grey level of its saturated pixels.

        Returns
        -------
        numpy.ndarray
            (rows, cols), of the frame's type; 0 where nothing is saturated.
        float
            Grey levels per level of it.
        """
        span = limit - self._black
        most = float(np.iinfo(frame.dtype).max) if frame.dtype.kind in "iu" else MAX_BEYOND * span
        unit = MAX_BEYOND * span / most
        unsaturated = frame < limit
        light = self._around((frame - np.float32(self._black)) * unsaturated)
        pattern = self._around(self._pattern * unsaturated)
        at = ~unsaturated
        estimate = self._pattern[at] * light[at] / np.maximum(pattern[at], _MIN_SEEN * self._level)
        out = np.zeros_like(frame)
        out[at] = np.clip((estimate - span) / unit, 0, most - 1) + 0.5
        return out, unit

    def _around(self, image: NDArray[Any]) -> NDArray[np.float32]:
        """Return the sum over the pixels around each."""
        size, border = (2 * self._reach + 1,) * 2, cv2.BORDER_CONSTANT
        sums: NDArray[np.float32] = cv2.boxFilter(image, cv2.CV_32F, size, normalize=False, borderType=border)
        return sums
