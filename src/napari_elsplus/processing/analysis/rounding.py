"""What a camera that rounds to whole grey levels does to the mean of many pixels.

Noise of half a grey level and more makes rounding harmless: means come out right. With less, pixels of one level are
all rounded the same way, and the mean is off by up to a part of a grey level. A dim plate's tenth may be as little.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

_OF_ROUNDING = 1 / 12
"""Variance that rounding itself adds."""


def pixel_noise_dn(one: NDArray[np.generic], other: NDArray[np.generic]) -> float:
    """Estimate the standard deviation of a pixel before rounding, from two images of the same thing.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> one, other = np.round(20.3 + rng.normal(0, 0.4, (2, 300, 300)))
    >>> round(pixel_noise_dn(one, other), 2)
    0.4
    """
    variance = float(np.var(np.asarray(one, np.float64) - np.asarray(other, np.float64))) / 2
    return float(np.sqrt(max(variance - _OF_ROUNDING, 0.0)))


def rounding_bias_dn(noise_dn: float, levels: NDArray[np.floating]) -> float:
    """By how much rounding may shift the mean of pixels, grey levels.

    Parameters
    ----------
    noise_dn : float
        Standard deviation of a pixel's noise before it is rounded.
    levels : numpy.ndarray
        Mean level of each pixel, of any shape: where they differ by grey levels, what rounding does evens out.

    Returns
    -------
    float
        Largest shift, of the first harmonic of the sawtooth that rounding is (Widrow, Kollar & Liu 1996,
        https://doi.org/10.1109/19.492748).

    Examples
    --------
    >>> alike, spread = np.full((50, 50), 4.25), np.linspace(4, 9, 2500)
    >>> [round(rounding_bias_dn(*case), 3) for case in ((0.3, alike), (0.3, spread), (1.0, alike))]
    [0.054, 0.0, 0.0]
    """
    evenness = abs(complex(np.mean(np.exp(2j * np.pi * np.asarray(levels, np.float64)))))
    return float(np.exp(-2 * (np.pi * noise_dn) ** 2) / np.pi * evenness)
