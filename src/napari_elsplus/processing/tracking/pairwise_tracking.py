"""Tracking by any pairwise registration function: the tracker with another registrar."""

from __future__ import annotations

from math import inf, nan
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from napari_elsplus.errors import InputError
from napari_elsplus.processing.tracking.registration.odds import write_prior
from napari_elsplus.processing.tracking.registration.pair_registration import PairRegistration, PreparedFrame, Registrar

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.front_end.grid import Grid
    from napari_elsplus.processing.tracking.motion.motion_prior import MotionPrior


class PairwiseShift(NamedTuple):
    """Result of a pairwise registration.

    Parameters
    ----------
    shift : tuple of float
        (rows, cols), pixels: ``moving[r, c]`` shows what ``fixed[r + rows, c + cols]`` shows, which is the sign of
        scikit-image's `phase_cross_correlation`.
    covariance : numpy.ndarray
        (2, 2) covariance of the shift, px squared.
    score : float
        Correlation of the overlap or the like, 0 to 1; written to the track.
    """

    shift: tuple[float, float]
    covariance: NDArray[np.float64]
    score: float = nan


class PairwiseRegistration(Protocol):
    """A function that registers two images."""

    def __call__(
        self, fixed: NDArray[np.float32], moving: NDArray[np.float32], expected: tuple[float, float]
    ) -> PairwiseShift | None:
        """Register an image on an earlier one.

        Parameters
        ----------
        fixed, moving : numpy.ndarray
            (n, n) float32, grey levels, zero outside of the bundle; not to be changed.
        expected : tuple of float
            Shift (rows, cols) predicted from the motion so far, pixels; (0, 0) where nothing is known.

        Returns
        -------
        PairwiseShift or None
            None where the images do not determine the shift.
        """


class PairwiseRegistrar(Registrar):
    """Registers frames by a function of two images, which accepts them; stretch and shear follow from the motion prior.

    Parameters
    ----------
    grid : Grid
        The grid of the tracking images.
    register : PairwiseRegistration
        ``register(fixed, moving, expected)`` returns a `PairwiseShift`, or None.
    """

    max_sigma_px = fall_of_correlation = inf
    registers_warps = False

    def __init__(self, grid: Grid, register: PairwiseRegistration) -> None:
        super().__init__(grid)
        self._register = register

    def register(
        self, earlier: PreparedFrame, later: PreparedFrame, motion: MotionPrior, *_: Any, **__: Any
    ) -> PairRegistration | None:
        """Register two frames; None where the function returned None.

        Parameters
        ----------
        earlier, later, motion
            As of :meth:`~.Registrar.register`.
        """
        warp = motion.warp
        found = self._register(earlier.image, later.image, (-warp.b, -warp.d))
        if found is None:
            return None
        covariance = np.asarray(found.covariance, np.float64)
        if covariance.shape != (2, 2) or not np.isfinite([*found.shift, *covariance.ravel()]).all():
            raise InputError(
                f"the registration returned the shift {found.shift} with covariance {found.covariance}",
                "return finite numbers and a (2, 2) covariance, or None where the images do not determine the shift",
            )
        warp, information = motion.at(-found.shift[0], -found.shift[1]), np.zeros((4, 4))
        write_prior(1.0, motion.terms, 1.0, information)
        information[np.ix_((1, 3), (1, 3))] += np.linalg.inv(covariance)
        return self.followed(PairRegistration(warp, information, found.score, 1.0, inf), motion)
