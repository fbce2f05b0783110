"""Log-likelihoods of candidate warps between two frames, also where a static pattern lies over both.

Dust, dead cores and a flat field of another day do not move with the specimen: they correlate at rest, wherever the
probe has gone. A specimen at rest is distinguished from such a pattern by what is left of the later frame when it is
explained by the earlier one at rest. Of a specimen at rest that is noise, which no other warp explains; of a specimen
that has moved it is the specimen.
"""

from __future__ import annotations

from math import hypot
from typing import TYPE_CHECKING, Final

import cv2
import numpy as np

from napari_elsplus.processing.tracking.registration.odds import BLOCK_PX, log_likelihood

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.motion.rolling_shutter import Warp

_REST_PX: Final = 1.0
"""Shift up to which frames may be at rest, pixels of full resolution; chosen: static patterns pull to within 0.4."""
_MOVED_NATS: Final = 20.0
"""Log-likelihood from which what is left has moved; chosen: noise of specimens at rest has up to 3.5."""
_MOVED_SHARE: Final = 1 / 3
"""Part of the log-likelihood at rest that it has then, too; chosen: of specimens at rest that rotate by 2 degrees or
deform by 4 pixels up to 0.1 is left, under patterns as strong as the specimen 0.4 to 1."""


def log_likelihoods(
    template: NDArray[np.float32],
    image: NDArray[np.float32],
    lit: tuple[NDArray[np.int32], NDArray[np.int32]],
    middle: float,
    warps: Sequence[Warp],
    sums: NDArray[np.float64],
) -> list[float]:
    """Return the log-likelihood of each warp above that of unrelated frames, nats.

    Parameters
    ----------
    template, image : numpy.ndarray
        (n, n) float32 high-passed frames of half resolution.
    lit : tuple of numpy.ndarray
        (n,) int32: first lit column of each row, and the one after the last.
    middle : float
        Row of the bundle's centre.
    warps : sequence of Warp
        Candidates, pixels of full resolution.
    sums : numpy.ndarray
        From :func:`~.odds.blocks`.
    """

    def of(later: NDArray[np.float32]) -> list[float]:
        halved = (np.array([warp.a, warp.b / 2, warp.s, warp.d / 2]) for warp in warps)
        return [log_likelihood(template, later, *lit, middle, half, sums) for half in halved]

    nats = of(image)
    rest = int(np.argmax(nats))
    if hypot(warps[rest].b, warps[rest].d) > _REST_PX:
        return nats
    left = of(unexplained(template, image, middle, warps[rest]))
    moved = max(left)
    return left if moved > left[rest] + _MOVED_NATS and moved > _MOVED_SHARE * nats[rest] else nats


def unexplained(
    template: NDArray[np.float32], image: NDArray[np.float32], middle: float, warp: Warp
) -> NDArray[np.float32]:
    """Return what a warped template leaves of an image, whatever its brightness about each pixel.

    Parameters
    ----------
    template, image, middle
        As in :func:`log_likelihoods`.
    warp : Warp
        From the template to the image, pixels of full resolution.

    Returns
    -------
    numpy.ndarray
        (n, n) float32.
    """
    forward = np.array([[1.0, warp.s, warp.d / 2 - warp.s * middle], [0.0, warp.a, warp.b / 2 + (1 - warp.a) * middle]])
    still = np.asarray(cv2.warpAffine(template, forward, image.shape[::-1]), np.float32)
    around = (BLOCK_PX, BLOCK_PX)
    gain = cv2.boxFilter(still * image, -1, around) / np.maximum(cv2.boxFilter(still * still, -1, around), 1e-3)
    left: NDArray[np.float32] = image - np.maximum(gain, 0) * still
    return left
