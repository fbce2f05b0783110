"""Image from scattered samples by regularised least squares, its smoothness chosen by generalised cross-validation.

Each sample is the image seen through a core: a Gaussian of the core's mode. The image minimises the weighted squares of
the samples' residuals plus its squared gradient times a smoothness; that is the posterior mean under a prior whose
power falls with the square of the frequency, as that of natural scenes does. The normal equations are solved by
conjugate gradients. The smoothness minimises the generalised cross-validation score (Golub, Heath and Wahba 1979,
doi:10.1080/00401706.1979.10489751), whose trace is estimated with one random probe (Hutchinson 1990,
doi:10.1080/03610919008812866).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import cv2
import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Image = NDArray[np.float32]

SMOOTHNESSES: Final = np.logspace(-3.5, 0.5, 9)
"""Smoothnesses that are compared, relative to the mean weight of a cell; chosen: from the noise of thousands of
electrons to that of one."""
_CAUTION: Final = 1.4
"""Factor on the trace in the score (Kim and Gu 2004, J. R. Stat. Soc. B 66, 337): without it, too little smoothness is
chosen where the noise is high, since residuals are compared and not images."""
MAX_ITERATIONS: Final = 60
"""Steps of conjugate gradients; measured: the residual is then below a thousandth at every smoothness."""
TOLERANCE: Final = 1e-3
"""Relative residual at which the iteration ends; chosen, far below the noise."""


class Samples(NamedTuple):
    """Samples on a grid of cells.

    Parameters
    ----------
    means : numpy.ndarray
        (rows, cols) float32 mean of the samples in each cell.
    weights : numpy.ndarray
        (rows, cols) float32 sum of their weights; 0 in a cell without samples.
    """

    means: Image
    weights: Image


def reconstruct(samples: Samples, aperture: float, smoothness: float) -> Image:
    """Return the image (rows, cols) float32 that explains samples.

    Parameters
    ----------
    samples : Samples
        The samples.
    aperture : float
        Standard deviation of the Gaussian through which a sample sees the image, cells.
    smoothness : float
        Weight of the squared gradient.
    """
    first = local_means(samples, aperture)[0]
    right = _seen(samples.weights * samples.means, aperture)
    return _solved(samples.weights, right[..., None], aperture, smoothness, first[..., None])[..., 0]


def choose_smoothness(samples: Samples, aperture: float) -> float:
    """Return the smoothness that minimises the generalised cross-validation score.

    Parameters
    ----------
    samples : Samples
        A part of the canvas, preferably with many samples.
    aperture : float
        As of :func:`reconstruct`.
    """
    weights, means = samples.weights, samples.means
    occupied = weights > 0
    density = float(weights.mean())
    root = np.sqrt(weights)
    probe = np.random.default_rng(0).choice(np.array([-1, 1], np.float32), weights.shape) * occupied
    right = np.stack([_seen(weights * means, aperture), _seen(root * probe, aperture)], axis=-1)
    start = np.stack([local_means(samples, aperture)[0], np.zeros_like(means)], axis=-1)
    count = int(occupied.sum())
    scores = []
    for relative in SMOOTHNESSES[::-1]:
        start = _solved(weights, right, aperture, float(relative) * density, start)
        fitted = _seen(start, aperture)
        misfit = float((weights * (means - fitted[..., 0]) ** 2).sum(dtype=np.float64))
        trace = float((probe * root * fitted[..., 1]).sum(dtype=np.float64))
        scores.append(count * misfit / max(count - _CAUTION * trace, 1.0) ** 2)
    best = len(scores) - 1 - int(np.argmin(scores))
    return float(SMOOTHNESSES[best]) * density


def local_means(samples: Samples, sigma: float) -> tuple[Image, Image]:
    """Return the samples' local means and their local density, (rows, cols) float32 each.

    Parameters
    ----------
    samples : Samples
        The samples.
    sigma : float
        Standard deviation of the Gaussian over which they are averaged, cells.
    """
    density = _seen(samples.weights, sigma)
    total = _seen(samples.weights * samples.means, sigma)
    return np.divide(total, density, out=np.zeros_like(total), where=density > 1e-6 * density.max()), density


def _seen(image: Image, aperture: float) -> Image:
    """Return an image as it is seen through the aperture; its own adjoint."""
    blurred: Image = cv2.GaussianBlur(image, (0, 0), aperture, borderType=cv2.BORDER_CONSTANT)
    return blurred.reshape(image.shape)


def _rough(image: Image) -> Image:
    """Return minus the Laplacian of an image (rows, cols, k), whose edges are free."""
    curved: Image = cv2.Laplacian(image, -1, ksize=1, borderType=cv2.BORDER_REPLICATE)
    return -curved.reshape(image.shape)


def _solved(weights: Image, right: Image, aperture: float, smoothness: float, start: Image) -> Image:
    """Solve the normal equations for each channel of the right side (rows, cols, k) by conjugate gradients."""
    heavy = weights[..., None]

    def normal(image: Image) -> Image:
        return _seen(heavy * _seen(image, aperture), aperture) + np.float32(smoothness) * _rough(image)

    def product(one: Image, other: Image) -> NDArray[np.float64]:
        return np.asarray(np.einsum("rck,rck->k", one, other, dtype=np.float64))

    values = start.copy()
    rest = right - normal(values)
    step = rest.copy()
    power = product(rest, rest)
    enough = TOLERANCE**2 * product(right, right)
    for _ in range(MAX_ITERATIONS):
        if (power <= enough).all():
            break
        moved = normal(step)
        length = (power / np.maximum(product(step, moved), 1e-30)).astype(np.float32)
        values += length * step
        rest -= length * moved
        power, before = product(rest, rest), power
        step = rest + (power / np.maximum(before, 1e-30)).astype(np.float32) * step
    return values
