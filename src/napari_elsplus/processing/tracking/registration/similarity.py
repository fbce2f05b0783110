"""Normalised correlation of two frames, and gain and offset by regression."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from napari_elsplus.processing.compiled import lean_kernel
from napari_elsplus.processing.tracking.front_end.sampling import row_shift

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.front_end.sampling import FramePair


@lean_kernel
def tone_between(pair: FramePair, warp: NDArray[np.float64], row_step: int) -> tuple[float, float]:
    """Estimate gain and offset of an image against a template by regression, from some rows and the nearest pixels.

    1 and 0 where the template is even.

    Parameters
    ----------
    pair : FramePair
        Frames that are compared.
    warp : numpy.ndarray
        (4,) a, b, s, d.
    row_step : int
        Every how many rows are used.
    """
    template, image = pair.template, pair.image
    count, t1, i1, tt, ti = 0.0, 0.0, 0.0, 0.0, 0.0
    for row in range(1, len(template) - 1, row_step):
        above, down, whole, across, begin, end = row_shift(pair, row, warp)
        nearest, aside = above + int(down + 0.5), whole + int(across + 0.5)
        for col in range(begin, end):
            t, i = template[row, col], image[nearest, col + aside]
            t1 += t
            i1 += i
            tt += t * t
            ti += t * i
        count += end - begin
    spread = tt * count - t1 * t1
    if not spread > 0:
        return 1.0, 0.0
    gain = (ti * count - t1 * i1) / spread
    return gain, (i1 - gain * t1) / count


@lean_kernel
def correlation_from_sums(count: float, template: float, image: float, both: float) -> float:
    """Return the correlation of two frames; 0 where one of them is even.

    Parameters
    ----------
    count : float
        Number of pixels.
    template, image, both : float
        Sums of the squared deviations from the means, and of their product.
    """
    if count < 2 or not (template > 0 and image > 0):
        return 0.0
    return float(both / np.sqrt(template * image))
