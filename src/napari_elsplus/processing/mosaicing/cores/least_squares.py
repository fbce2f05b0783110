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
from scipy.sparse.linalg import LinearOperator, cg

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
    right = _seen(samples.weights * samples.means, aperture)
    return _solved(samples.weights, right, aperture, smoothness, local_means(samples, aperture)[0])


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
    seen, seen_probe = _seen(weights * means, aperture), _seen(root * probe, aperture)
    image, response = local_means(samples, aperture)[0], np.zeros_like(means)
    count = int(occupied.sum())
    scores = []
    for relative in SMOOTHNESSES[::-1]:
        image = _solved(weights, seen, aperture, float(relative) * density, image)
        response = _solved(weights, seen_probe, aperture, float(relative) * density, response)
        misfit = float((weights * (means - _seen(image, aperture)) ** 2).sum(dtype=np.float64))
        trace = float((probe * root * _seen(response, aperture)).sum(dtype=np.float64))
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
    return np.asarray(cv2.GaussianBlur(image, (0, 0), aperture, borderType=cv2.BORDER_CONSTANT), np.float32)


def _rough(image: Image) -> Image:
    """Return minus the Laplacian of an image, whose edges are free."""
    curved: Image = cv2.Laplacian(image, -1, ksize=1, borderType=cv2.BORDER_REPLICATE)
    return -curved


def _solved(weights: Image, right: Image, aperture: float, smoothness: float, start: Image) -> Image:
    """Solve the normal equations for a right side (rows, cols) by conjugate gradients."""

    def normal(flat: Image) -> Image:
        image = flat.reshape(right.shape)
        data = _seen(weights * _seen(image, aperture), aperture)
        return (data + np.float32(smoothness) * _rough(image)).ravel()

    equations = LinearOperator((right.size, right.size), normal, dtype=np.float32)
    values, _ = cg(equations, right.ravel(), start.ravel(), rtol=TOLERANCE, maxiter=MAX_ITERATIONS)
    return np.asarray(values, np.float32).reshape(right.shape)
