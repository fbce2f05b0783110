"""Deformation of tissue between frames: smooth fields that map frames onto the mosaic, where frames show it.

A probe drags soft tissue along, which then has another shape in each frame. The mean of all frames at their poses has
the mean shape; a frame's field, a polynomial of third degree in rows and columns, is fitted to it by Gauss-Newton steps
under a Gaussian prior. The Bayesian information criterion decides whether fields are modelled at all, by the median
of a few frames: rigid scenes are left as they are.

References
----------
Szeliski and Coughlan, Int. J. Comput. Vis. 22, 199 (1997), doi:10.1023/A:1007996332012; Schwarz, Ann. Stat. 6, 461
(1978), doi:10.1214/aos/1176344136.
"""

from __future__ import annotations

from functools import cached_property
from math import ceil, log
from typing import TYPE_CHECKING, Any, Final

import cv2
import numpy as np
from numpy.polynomial import legendre

from napari_elsplus.processing.mosaicing.mosaic import Insertion, Mosaic
from napari_elsplus.processing.tracking.front_end.grid import FIELD, Grid
from napari_elsplus.processing.tracking.motion.pose import Pose, TrackingState
from napari_elsplus.processing.tracking.registration.motion_models import turned_by, unsheared
from napari_elsplus.processing.tracking.registration.odds import CORRELATED_PX

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

    from napari_elsplus.processing.mosaicing.tiles import TiledCanvas

    Floats = NDArray[np.float64]

DEGREE: Final = 3
"""Of the polynomials; chosen: a wave as long as the field is followed."""
COEFFICIENT_SIGMA_PX: Final = 1.0
"""Prior standard deviation of each coefficient, pixels of the grid; chosen: a strain of 3 % makes 1 to 3."""
MAX_TESTED: Final = 5
"""Frames that decide whether fields are modelled, spread over the track; chosen. Three decide where they agree: rigid
scenes lose 60 nats by a field."""
ROUNDS: Final = 4
"""Of fitting fields and averaging the frames freed of them; chosen: with two, mosaics of six recordings correlate with
the tissue at rest by up to 0.002 less; a prior about the fields of the neighbouring frames adds at most 0.001."""
_SAMPLES_ACROSS: Final = 120
"""Pixels of the field that are compared, along a diameter; chosen: half of those of the grid."""
_TESTED_ACROSS: Final = 42
"""The same where it is tested whether tissue deforms; measured: in 75 frames of the tests' scenes under strains of 0 to
3 % what a field gains differs by up to 15 nats from that with twice the points, and never in its sign."""
_HIGH_PASS_DIAMETERS: Final = 1 / 30
"""Standard deviation of the Gaussian that is subtracted, as that of the registration: haze does not move."""
_REDUCED_SIGMA_PX: Final = 2.0
"""The same on the reduced image on which it is computed; chosen: far from its pixels' size."""
_MARGIN: Final = 0.96
"""Part of the field that is compared, within which slopes exist."""

_PIXELS: Final = np.eye(2)[:, :, None]
"""A pixel down, and one to the right, each (2, 1)."""


class Deformation:
    """Fields of frames: fitted to a mosaic, and undone.

    Parameters
    ----------
    grid : Grid
        The frames' grid.
    samples_across : int
        Pixels of the field that are compared, along a diameter.
    """

    def __init__(self, grid: Grid, samples_across: int = _SAMPLES_ACROSS) -> None:
        self._grid = grid
        self._step = max(1, round(FIELD * grid.diameter / samples_across))
        self._high_pass_px = _HIGH_PASS_DIAMETERS * grid.diameter
        self._radius = 0.5 * FIELD * grid.diameter
        points = self._points(self._step)
        self._samples = points[:, np.hypot(*points) < _MARGIN * self._radius]
        self._basis = self._terms(self._samples)
        values = float(self._step**2 * self._samples.shape[1] / CORRELATED_PX)
        self._values, self._penalty = values, len(self._basis) * log(values)
        self._fields: dict[int, Floats] = {}

    def fit(self, index: int, image: NDArray[np.float32], pose: Pose, mosaic: Mosaic) -> float:
        """Fit a frame's field by one step from where it is; return what that gains by the information criterion, nats.

        Parameters
        ----------
        index : int
            Of the frame.
        image : numpy.ndarray
            (side, side) float32.
        pose : Pose
            Of the frame in the mosaic.
        mosaic : Mosaic
            With the frame's surroundings drawn.
        """
        field = self._fields.setdefault(index, np.zeros((2, len(self._basis))))
        matrix = turned_by(pose.angle) @ unsheared(pose.velocity, self._grid.shutter.line_periods_per_frame)
        extent = mosaic.extent_of(pose).grown(2)
        shown, _ = mosaic.read(extent)
        at = matrix @ self._samples + np.array([[pose.row - extent.top], [pose.col - extent.left]])
        around = np.stack([at, *(at + side * pixel for pixel in _PIXELS for side in (1, -1))], axis=1)
        expected, below, above, right, left = self._high_passed(shown, around)
        slopes = np.array([below - above, right - left]) / 2
        moved = self._samples + np.einsum("ij,jk->ik", field, self._basis) + np.reshape(self._grid.centre, (2, 1))
        seen = self._high_passed(image, moved)
        energy = float(expected @ expected)
        if not energy > 0:
            return 0.0
        gain = float(seen @ expected) / energy
        miss = seen - gain * expected
        design = (gain * (matrix.T @ slopes)[:, None] * self._basis).reshape(field.size, -1)
        noise = float(miss @ miss) / self._values
        # without a BLAS: for so little its threads wait for each other, a hundred times as long on a busy computer
        normal = cv2.mulTransposed(design, aTa=False) / noise + np.eye(field.size) / COEFFICIENT_SIGMA_PX**2
        pull = np.einsum("ik,k->i", design, miss) / noise + field.ravel() / COEFFICIENT_SIGMA_PX**2
        step = np.linalg.solve(normal, pull)
        left = miss - np.einsum("i,ik->k", step, design)
        self._fields[index] = field - step.reshape(field.shape)
        return 0.5 * self._values * log(float(miss @ miss) / float(left @ left)) - self._penalty

    def undone(self, index: int, image: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the image of a frame as it would be without its field.

        Parameters
        ----------
        index : int
            Of the frame.
        image : numpy.ndarray
            (side, side) float32.
        """
        if index not in self._fields:
            return image
        points, terms = self._whole_grid
        moved = points + np.tensordot(self._fields[index], terms, 1) + np.reshape(self._grid.centre, (2, 1, 1))
        rows, cols = moved.astype(np.float32)
        return np.asarray(cv2.remap(image, cols, rows, cv2.INTER_CUBIC), np.float32)

    def on(self, grid: Grid) -> Deformation:
        """Return the same fields for images on another grid.

        Parameters
        ----------
        grid : Grid
            Of the same bundle.
        """
        other = Deformation(grid)
        ratio = grid.diameter / self._grid.diameter
        other._fields = {index: ratio * field for index, field in self._fields.items()}
        return other

    @cached_property
    def _whole_grid(self) -> tuple[Floats, Floats]:
        """Return all points of the grid, (2, side, side), and the polynomials there, (terms, side, side)."""
        points = self._points(1)
        return points, self._terms(points)

    def _points(self, step: int) -> Floats:
        """Return rows and columns of every few pixels of the grid, from the field's centre, (2, n, n)."""
        down, across = (np.arange(0, self._grid.side, step) - middle for middle in self._grid.centre)
        return np.stack(np.meshgrid(down, across, indexing="ij"))

    def _terms(self, points: Floats) -> Floats:
        return legendre_terms(np.clip(points / self._radius, -1.1, 1.1))

    def _high_passed(self, image: NDArray[np.float32], at: Floats) -> Floats:
        """Return an image at points (2, ..., n), freed of its blurred light; its pixels that are 0 show nothing."""
        both = cv2.merge((image, (image != 0).astype(np.float32)))
        size = [ceil(length / max(1.0, self._high_pass_px / _REDUCED_SIGMA_PX)) for length in image.shape]
        scale = np.divide(size, image.shape)
        sigmas = (self._high_pass_px * scale).tolist()
        reduced = cv2.resize(both, size[::-1], interpolation=cv2.INTER_AREA)
        blurred = cv2.GaussianBlur(reduced, (0, 0), sigmas[1], sigmaY=sigmas[0])
        light, lit = _sampled(both, at)
        smooth, share = _sampled(blurred, ((at.T + 0.5) * scale - 0.5).T)
        return np.asarray(light - smooth / np.maximum(share, 1e-3) * lit, np.float64)


def estimate_deformation(
    image: Callable[[int], NDArray[np.float32]],
    poses: Sequence[Pose],
    mosaics: Mapping[int, TiledCanvas],
    weights: NDArray[np.float32],
) -> Deformation | None:
    """Estimate the deformation of the tissue in all tracked frames; None where the scene is rigid.

    Parameters
    ----------
    image : callable
        Returns the image (side, side) of a frame by its index, valid until the next call.
    poses : sequence of Pose
        Final poses of all frames.
    mosaics : mapping of int to TiledCanvas
        Mosaics of the frames as they are, by segment; those into which images were not inserted are left out.
    weights : numpy.ndarray
        (side, side) weight of each pixel of a frame in the mean.
    """
    drawn = {segment: mosaic for segment, mosaic in mosaics.items() if isinstance(mosaic, Mosaic)}
    tracked = [k for k, pose in enumerate(poses) if pose.state is TrackingState.TRACKED and pose.segment in drawn]
    if not tracked:
        return None
    grid = drawn[poses[tracked[0]].segment].grid
    deformation = Deformation(grid, _TESTED_ACROSS)
    tested = tracked[:: ceil(len(tracked) / MAX_TESTED)]
    # of the frames of a jerk some are distorted by uneven motion: more than half of all must need a field
    rigid = 0
    for k in tested:
        rigid += deformation.fit(k, image(k), poses[k], drawn[poses[k].segment]) <= 0
        if 2 * rigid >= len(tested):
            return None
    deformation = Deformation(grid)
    for _ in range(ROUNDS):
        means = {segment: Mosaic(grid, Insertion.FEATHERED, weights=weights) for segment in drawn}
        for k in tracked:
            pose, undone = poses[k], deformation.undone(k, image(k))
            means[pose.segment].insert(undone, pose.row, pose.col, pose.velocity, pose.angle)
        for k in tracked:
            deformation.fit(k, image(k), poses[k], means[poses[k].segment])
    return deformation


def legendre_terms(points: Floats) -> Floats:
    """Return the products of Legendre polynomials of rows and columns up to :data:`DEGREE`, (terms, ...).

    Parameters
    ----------
    points : numpy.ndarray
        (2, ...) rows and columns, from -1 to 1 across the field.
    """
    down, across = (np.moveaxis(legendre.legvander(axis, DEGREE), -1, 0) for axis in points)
    return np.array([down[i] * across[j] for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)])


def _sampled(images: NDArray[Any], at: Floats) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return both channels of an image (rows, cols, 2) at points (2, ..., n) between its pixels."""
    rows, cols = at.astype(np.float32).reshape(2, -1, at.shape[-1])
    sampled = cv2.remap(images, cols, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    one, two = cv2.split(sampled)
    return np.reshape(one, at.shape[1:]), np.reshape(two, at.shape[1:])
