"""Standard deviations of residuals that have outliers, or that are not independent.

Through a fibre bundle, the residuals of any fit are correlated within a core, by its transmission, which photon
statistics do not contain. Residuals are therefore summed over clusters (columns, arcs, runs of frames) wider than a
core, and the spread of those sums gives the covariance: the sandwich estimator (Liang & Zeger 1986,
https://doi.org/10.1093/biomet/73.1.13).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

MAD_TO_SIGMA: Final = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation; derived, the inverse of the normal
quantile of 3/4."""


def robust_sigma(deviations: NDArray[np.floating], axis: int | None = None) -> Floats:
    """Return the standard deviation of normally distributed deviations by the median of their magnitudes.

    Parameters
    ----------
    deviations : numpy.ndarray
        Deviations from the centre of the distribution, of which less than half may be outliers.
    axis : int, optional
        Axis of the median; all values by default.

    Examples
    --------
    >>> round(float(robust_sigma(np.r_[np.random.default_rng(0).normal(0, 2, 900), np.full(100, 50.0)])), 1)
    2.2
    """
    return np.asarray(MAD_TO_SIGMA * np.median(np.abs(deviations), axis=axis), np.float64)


def clustered_influence(jacobian: Floats, residuals: Floats, clusters: NDArray[np.intp], count: int) -> Floats:
    """Return the contribution of each cluster of residuals to the error of a least-squares fit (its influence).

    The covariance of the parameters is ``influence.T @ influence``; that of a difference of two fits of the same
    clusters follows from the difference of their influences, with what they share cancelled.

    Parameters
    ----------
    jacobian : numpy.ndarray
        Derivatives of the model, shape (samples, parameters).
    residuals : numpy.ndarray
        Data minus model, shape (samples,).
    clusters : numpy.ndarray
        Cluster of each sample, 0 to ``count - 1``, shape (samples,).
    count : int
        Number of clusters.

    Returns
    -------
    numpy.ndarray
        Shape (count, parameters), float64.

    Examples
    --------
    >>> x = np.linspace(-1, 1, 400)
    >>> noise = np.random.default_rng(0).normal(0, 0.5, x.size)
    >>> influence = clustered_influence(np.c_[np.ones_like(x), x], noise, np.arange(400) // 10, 40)
    >>> bool(0.02 < np.sqrt(np.square(influence[:, 0]).sum()) < 0.03)  # 0.5 / sqrt(400) = 0.025
    True
    """
    return estimator_influence(jacobian * residuals[:, None], jacobian.T @ jacobian, clusters, count)


def estimator_influence(scores: Floats, curvature: Floats, clusters: NDArray[np.intp], count: int) -> Floats:
    """Return the influence of each cluster of samples on an estimate that solves ``scores.sum(0) == 0``.

    Parameters
    ----------
    scores : numpy.ndarray
        Score of each sample, the gradient of its log-likelihood, shape (samples, parameters).
    curvature : numpy.ndarray
        Negative derivative of the sum of the scores by the parameters, shape (parameters, parameters).
    clusters : numpy.ndarray
        Cluster of each sample, 0 to ``count - 1``, shape (samples,).
    count : int
        Number of clusters.

    Returns
    -------
    numpy.ndarray
        Shape (count, parameters), float64; zero for clusters without samples, not finite without curvature.
    """
    sums = np.stack([np.bincount(clusters, weights=column, minlength=count) for column in scores.T], axis=1)
    filled = np.count_nonzero(np.bincount(clusters, minlength=count))
    freedom = filled / max(filled - scores.shape[1] / 2, 1.0)
    with np.errstate(over="ignore", invalid="ignore"):  # a diverged fit has no curvature: not finite, as it should be
        return np.asarray(np.sqrt(freedom) * (sums @ np.linalg.pinv(curvature)), np.float64)


def information_criterion(omitted: Floats, influence: Floats, parameters: int) -> float:
    """Return the Bayesian information criterion of a model: Wald statistic of what it omits, and its parameters.

    The Wald statistic stands in for the likelihood's loss, since its covariance also holds for lumpy residuals.

    Parameters
    ----------
    omitted : numpy.ndarray
        Combinations of the parameters of a fuller fit that vanish in the model, (combinations,).
    influence : numpy.ndarray
        Contribution of each cluster to their errors, (clusters, combinations).
    parameters : int
        Number of the model's parameters.
    """
    wald = float(omitted @ np.linalg.pinv(influence.T @ influence) @ omitted) if len(omitted) else 0.0
    return wald + parameters * float(np.log(len(influence)))


def small_sample_factor(free: int) -> float:
    """Return the standard deviation of Student's t: the factor on one that was estimated from few residuals.

    Parameters
    ----------
    free : int
        Degrees of freedom; fewer than 3, of which t has no standard deviation, count as 3.

    Examples
    --------
    >>> round(small_sample_factor(4), 3), round(small_sample_factor(100), 3)
    (1.414, 1.01)
    """
    return float(np.sqrt(max(free, 3) / (max(free, 3) - 2)))


def newey_west_sigma(influence: Floats, neighbours: int) -> float:
    """Return the standard deviation of an estimate from serially correlated clusters by Newey and West's estimator.

    Parameters
    ----------
    influence : numpy.ndarray
        Contribution of each cluster to the error, in order, shape (clusters,).
    neighbours : int
        Number of successive clusters over which contributions are summed before squaring; the sums overlap (Newey
        & West 1987, https://doi.org/10.2307/1913610).

    Returns
    -------
    float
        In the unit of the influence.

    Notes
    -----
    Where the errors of neighbours are opposite, as for a core on the border between two clusters, a sum of squares
    alone would be too large; where they are alike, too small.

    Examples
    --------
    >>> alternating = np.tile([1.0, -1.0], 10)
    >>> round(newey_west_sigma(alternating, 1), 2), round(newey_west_sigma(alternating, 2), 2)
    (4.47, 1.05)
    """
    sums = np.convolve(influence, np.ones(neighbours))
    lost = neighbours / len(influence) if neighbours > 1 else 0.0  # all of them together sum to zero
    return float(np.sqrt(np.square(sums).sum() / neighbours / (1 - lost)))


def overlapping_influence(
    jacobian: Floats,
    residuals: Floats,
    clusters: NDArray[np.intp],
    count: int,
    neighbours: int,
    removed: Floats | None = None,
) -> Floats:
    """Return the influence of overlapping runs of serially correlated clusters on a least-squares fit.

    As :func:`clustered_influence`, for correlated neighbours. A fit removes a part of every slow variation from its
    residuals; this is corrected for, so that the covariance is unbiased for independent noise.

    Parameters
    ----------
    jacobian, residuals, clusters, count
        As in :func:`clustered_influence`; clusters are numbered in order.
    neighbours : int
        Number of clusters in a run.
    removed : numpy.ndarray, optional
        Derivatives of the model of which the residuals are, if that has further parameters; shape (samples, more).

    Returns
    -------
    numpy.ndarray
        Shape (runs, parameters); the covariance is ``influence.T @ influence``.
    """
    removed = jacobian if removed is None else removed
    last = np.arange(count + neighbours - 1)[:, None]
    run = ((clusters <= last) & (clusters > last - neighbours)).astype(np.float64)
    scores = run @ (jacobian * residuals[:, None])
    inverse = np.linalg.pinv(jacobian.T @ jacobian)
    shared = np.einsum("rs,sp,sq->rpq", run, jacobian, removed, optimize=True)
    lost = (shared @ np.linalg.pinv(removed.T @ removed) @ shared.transpose(0, 2, 1)).sum(axis=0)
    seen = jacobian.T @ (jacobian * run.sum(axis=0)[:, None]) - lost
    expected = np.linalg.cholesky(inverse @ seen @ inverse)
    return np.asarray(scores @ inverse @ np.linalg.solve(expected.T, np.linalg.cholesky(inverse).T), np.float64)
