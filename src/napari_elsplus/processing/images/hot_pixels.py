"""Hot pixels of the camera, found in the background and replaced in raw frames by the median of their neighbours.

Their dark current is subtracted with the background, but its noise is not, and a saturated one shows nothing at all.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, TypeVar

import cv2
import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

Pixel = TypeVar("Pixel", bound=np.generic)

EXCESS: Final = 24.0
"""Excess of a hot pixel over the brightest of its eight neighbours, in the median excess of a local maximum; derived:
of noise, which decays faster than exponentially, one pixel in 2^24 exceeds it."""
PATTERN: Final = 4.0
"""Excess of a hot pixel, in the range of the pixels around it; derived: that of a core centred on a pixel is at most 3,
where cores are two pixels apart."""
MIN_EXCESS: Final = 3.0
"""Least excess, grey levels; chosen: the noise of less dark current is below that of the camera."""
SAMPLED: Final = 8
"""Step of the rows from which that median is estimated; chosen: thousands of pixels are left."""
MAX_SHARE: Final = 0.01
"""Of the pixels that may be hot; chosen: a background of which more stand out has structure of another kind."""


class HotPixels:
    """Hot pixels of one camera region.

    Parameters
    ----------
    background : numpy.ndarray or None
        (rows, cols) mean frame of the dark tube, grey levels.

    Attributes
    ----------
    rows, cols : numpy.ndarray
        Their positions in the frame.
    """

    def __init__(self, background: NDArray[np.float32] | None) -> None:
        hot = np.zeros((0, 0), bool) if background is None else _stand_out(background)
        self.rows, self.cols = np.nonzero(hot)
        around = [(down, across) for down in (-1, 0, 1) for across in (-1, 0, 1) if (down, across) != (0, 0)]
        self._around = np.array(around).T[:, :, None]

    def __len__(self) -> int:
        """Return the number of hot pixels."""
        return len(self.rows)

    def mended(self, raw: NDArray[Pixel]) -> NDArray[Pixel]:
        """Return a copy of a raw frame with its hot pixels replaced; without any, the frame itself.

        Parameters
        ----------
        raw : numpy.ndarray
            (rows, cols) grey levels.
        """
        if not len(self):
            return raw
        mended = np.array(raw)
        rows, cols = (
            np.clip(at + by, 0, size - 1)
            for at, by, size in zip((self.rows, self.cols), self._around, raw.shape, strict=True)
        )
        mended[self.rows, self.cols] = np.median(raw[rows, cols], axis=0).astype(raw.dtype)
        return mended


def _stand_out(background: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return the pixels of a background that stand out of their neighbours, (rows, cols) bool."""
    frame, ring = np.asarray(background, np.float32), np.ones((3, 3), np.uint8)
    ring[1, 1] = 0
    brightest = cv2.dilate(frame, ring)
    excess = frame - brightest
    some = excess[::SAMPLED]
    maxima = some[some > 0]
    noise = EXCESS * float(np.median(maxima)) if maxima.size else 0.0
    hot = np.asarray(excess > max(noise, MIN_EXCESS))
    if hot.any():
        lowest = cv2.erode(frame, np.ones((5, 5), np.uint8))
        hot &= excess > PATTERN * (brightest - lowest)
    return hot if hot.mean() <= MAX_SHARE else np.zeros_like(hot)
