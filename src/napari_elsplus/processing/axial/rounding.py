"""Bias of the mean of many pixels by a camera's rounding to whole grey levels (quantisation).

Noise of half a grey level and more dithers: means are unbiased. With less, pixels of one level are all rounded the same
way, and the mean is biased by up to half a grey level, which may be as much as a tenth of a dim plate's signal.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

_ROUNDING_VARIANCE = 1 / 12
"""Variance added by rounding, squared grey levels; derived: that of a uniform distribution of width 1."""


def pixel_noise_dn(one: NDArray[np.generic], other: NDArray[np.generic]) -> float:
    """Estimate a pixel's noise before rounding from the difference of two images of the same object.

    Parameters
    ----------
    one, other : numpy.ndarray
        Images of one shape, whole grey levels.

    Returns
    -------
    float
        Standard deviation, grey levels.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> one, other = np.round(20.3 + rng.normal(0, 0.4, (2, 300, 300)))
    >>> round(pixel_noise_dn(one, other), 2)
    0.4
    """
    variance = float(np.var(np.asarray(one, np.float64) - np.asarray(other, np.float64))) / 2
    return float(np.sqrt(max(variance - _ROUNDING_VARIANCE, 0.0)))


def rounding_bias_dn(noise_dn: float, levels: NDArray[np.floating]) -> float:
    """Return the largest bias of the mean of pixels by rounding, grey levels.

    Parameters
    ----------
    noise_dn : float
        Standard deviation of a pixel's noise before rounding, grey levels.
    levels : numpy.ndarray
        Mean level of each pixel, of any shape; where these vary by a grey level and more, the bias averages out.

    Returns
    -------
    float
        Amplitude of the first harmonic of the sawtooth of the rounding error (Widrow, Kollar & Liu 1996,
        https://doi.org/10.1109/19.492748).

    Examples
    --------
    >>> alike, spread = np.full((50, 50), 4.25), np.linspace(4, 9, 2500)
    >>> [round(rounding_bias_dn(*case), 3) for case in ((0.3, alike), (0.3, spread), (1.0, alike))]
    [0.054, 0.0, 0.0]
    """
    coherence = abs(complex(np.mean(np.exp(2j * np.pi * np.asarray(levels, np.float64)))))
    return float(np.exp(-2 * (np.pi * noise_dn) ** 2) / np.pi * coherence)
