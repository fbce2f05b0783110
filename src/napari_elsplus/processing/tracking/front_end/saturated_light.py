"""Light that saturated pixels did not show, from the pixels around them.

Saturated cores are alike in all frames: divided by the flat field their pattern stands still, and competes with the
specimen. A pixel is therefore estimated from the unsaturated ones around it, each compared with the light by which the
dark tube's background shows the same cores.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from napari_elsplus.processing.compiled import lean_kernel

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
        out, span = np.zeros_like(frame), limit - self._black
        most = float(np.iinfo(frame.dtype).max) if frame.dtype.kind in "iu" else MAX_BEYOND * span
        unit = MAX_BEYOND * span / most
        limits = limit, self._black, _MIN_SEEN * self._level, self._reach, unit, most - 1
        write_beyond(frame, self._pattern, *limits, np.empty((2, frame.shape[1])), out)
        return out, unit


@lean_kernel
def write_beyond(
    frame: NDArray[Any], pattern: NDArray[np.float32], limit: float, black: float, least: float, reach: int,
    unit: float, most: float, sums: NDArray[np.float64], out: NDArray[Any],
) -> None:  # fmt: skip
    """Write what the light of saturated pixels exceeds them by, given the pattern of the cores; others are left.

    Parameters
    ----------
    frame, out : numpy.ndarray
        (rows, cols) raw frame, and what is written, of the same type.
    pattern : numpy.ndarray
        (rows, cols) float32: light of the background.
    limit, black : float
        Grey levels of saturated pixels and without light.
    least : float
        Smallest sum of the background's light in the unsaturated pixels that are compared.
    reach : int
        Distance of the farthest of these, rows and columns.
    unit, most : float
        Grey levels per level of `out`, and the largest of these but for rounding.
    sums : numpy.ndarray
        (2, cols) float64, filled: sums over the rows around one.
    """
    rows, cols = frame.shape
    sums[:] = 0.0
    for row in range(-reach, rows):
        for r, sign in ((row + reach, 1.0), (row - reach - 1, -1.0)):
            if 0 <= r < rows:
                for c in range(cols):
                    seen = sign * (frame[r, c] < limit)
                    sums[0, c] += seen * (frame[r, c] - black)
                    sums[1, c] += seen * pattern[r, c]
        if row < 0:
            continue
        light, seen = sums[0, :reach].sum(), sums[1, :reach].sum()
        for col in range(cols):
            if col + reach < cols:
                light += sums[0, col + reach]
                seen += sums[1, col + reach]
            if col > reach:
                light -= sums[0, col - reach - 1]
                seen -= sums[1, col - reach - 1]
            if frame[row, col] >= limit:
                more = pattern[row, col] * light / max(seen, least) - (limit - black)
                out[row, col] = min(max(more, 0.0) / unit, most) + 0.5
