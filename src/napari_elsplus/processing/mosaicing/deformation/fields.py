"""Deformation of tissue between frames: smooth fields that free frames of it, where frames show it.

A probe drags soft tissue along, which then has another shape in each frame. A frame's field, a polynomial of third
degree in rows and columns, maps it onto tissue at rest. Of two frames the images show how their fields differ. Like the
positions of a pose graph, the fields of all frames are solved for at once, by Gauss-Newton steps over pairs of frames:
those that follow one another, and those that show a place again. Beforehand a field is zero but for chance. Shifts are
freer than shapes: where tissue is stretched, the same displacement of the probe covers less of it. What then is alike
in all frames is taken for the shape of the tissue (:mod:`~.rest_shape`).

References
----------
Szeliski and Coughlan, Int. J. Comput. Vis. 22, 199 (1997), doi:10.1023/A:1007996332012.
"""

from __future__ import annotations

from functools import cached_property
from math import ceil, log
from typing import TYPE_CHECKING, Any, Final

import cv2
import numpy as np
from numpy.polynomial import legendre
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, cg, splu

from napari_elsplus.processing.mosaicing.deformation.rest_shape import LENGTH_DIAMETERS, static_part
from napari_elsplus.processing.tracking.front_end.grid import FIELD, Grid
from napari_elsplus.processing.tracking.registration.motion_models import turned_by, unsheared
from napari_elsplus.processing.tracking.registration.odds import CORRELATED_PX

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.motion.pose import Pose

    Floats = NDArray[np.float64]

DEGREE: Final = 3
"""Of the polynomials; chosen: a wave as long as the field is followed."""
COEFFICIENT_SIGMA_PX: Final = 0.5
SHIFT_SIGMA_PX: Final = 10.0
"""Prior standard deviations of the coefficients, and of those of degree 0, pixels of the grid; chosen on six recordings
under strains of 3 %, whose mosaics correlate with the tissue at rest by 0.97 in the mean, as with half or twice the
former and with 3 or 30 for the latter; by 0.96 with 1."""
_MIN_SHARED: Final = 0.2
_MIN_CORRELATION: Final = 0.3
"""Part of the field that two frames have in common, and their correlation, from which they are compared; chosen."""
_SAME: Final = 1e-9
"""Squared difference of two frames over the squared frame up to which they are one picture; chosen: far below noise,
and above what rounding leaves."""
_SAMPLES_ACROSS: Final = 60
"""Pixels of the field that are compared, along a diameter; chosen: a quarter of those of the grid, each with less than
one independent value."""
_HIGH_PASS_DIAMETERS: Final = 1 / 30
"""Standard deviation of the Gaussian that is subtracted, as that of the registration: haze does not move."""
_REDUCED_SIGMA_PX: Final = 2.0
"""The same on the reduced image on which it is computed; chosen: far from its pixels' size."""
_MARGIN: Final = 0.96
"""Part of the field that is compared, within which slopes exist."""
_TOLERANCE: Final = 1e-3
"""Relative residual of the equations of a step; chosen: the next step starts from what is left."""
_POINTS_ACROSS: Final = 5
"""Points across a frame at which its field is compared with those of others: 13 in all; derived: its terms are ten."""
_MAX_FRAMES: Final = 100
"""Frames of a segment that are compared, evenly chosen; chosen: their covariance is some 15 MB."""

_AROUND: Final = np.array([[0, 1, -1, 0, 0], [0, 0, 0, 1, -1]])[:, :, None]
"""A pixel, and those below, above, to the right and to the left of it, (2, 5, 1)."""


class Deformation:
    """Fields of frames: fitted to pairs of frames, and undone.

    Parameters
    ----------
    grid : Grid
        The frames' grid.
    """

    def __init__(self, grid: Grid) -> None:
        self._grid = grid
        self._step = max(1, round(FIELD * grid.diameter / _SAMPLES_ACROSS))
        self._high_pass_px = _HIGH_PASS_DIAMETERS * grid.diameter
        self._radius = 0.5 * FIELD * grid.diameter
        points = self._points(self._step)
        self._samples = points[:, self._within(points)]
        self._prior = np.full((2, len(self._terms(np.zeros((2, 1))))), COEFFICIENT_SIGMA_PX**-2)
        self._prior[:, 0] = SHIFT_SIGMA_PX**-2
        self._fields: dict[int, Floats] = {}

    def compare(
        self, images: tuple[NDArray[np.float32], NDArray[np.float32]], frames: tuple[int, int], poses: tuple[Pose, Pose]
    ) -> tuple[Floats, Floats, float] | None:
        """Return the normal equations of the fields of two frames, and how many values they rest on; None if unlike.

        Parameters
        ----------
        images : tuple of numpy.ndarray
            (side, side) float32, of both.
        frames : tuple of int
            Their indices.
        poses : tuple of Pose
            In one mosaic.

        Returns
        -------
        numpy.ndarray
            (2 m, 2 m) information on the m coefficients of each field, those of rows before those of columns.
        numpy.ndarray
            (2 m,) its product with the step to the solution.
        float
            Number of independent values, to which the squared residuals add up before it in units of the noise.
        """
        first, second = (
            turned_by(pose.angle) @ unsheared(pose.velocity, self._grid.shutter.line_periods_per_frame)
            for pose in poses
        )
        apart = np.array([[poses[0].row - poses[1].row], [poses[0].col - poses[1].col]])
        here, there = self._samples, np.linalg.solve(second, first @ self._samples + apart)
        shared = self._within(there)
        here, there = here[:, shared], there[:, shared]
        if here.shape[1] < _MIN_SHARED * self._samples.shape[1]:
            return None
        of_here, of_there = self._terms(here), self._terms(there)
        around = self._moved(frames[0], here, of_here)[:, None] + _AROUND
        expected, below, above, right, left = self._high_passed(images[0], around)
        seen = self._high_passed(images[1], self._moved(frames[1], there, of_there))
        both, energy = float(seen @ expected), float(expected @ expected)
        if not both > _MIN_CORRELATION * (energy * float(seen @ seen)) ** 0.5:
            return None
        gain = both / energy
        miss = seen - gain * expected
        slopes = gain / 2 * np.array([below - above, right - left])
        design = np.concatenate([slopes[:, None] * terms for terms in (of_here, of_there)])
        design[:2] *= -1
        design = design.reshape(-1, len(miss))
        values = float(self._step**2 * len(miss) / CORRELATED_PX)
        noise = float(miss @ miss) / values
        if not noise * values > _SAME * energy:
            return None
        # without a BLAS: for so little its threads wait for each other, a hundred times as long on a busy computer
        return cv2.mulTransposed(design, aTa=False) / noise, -np.einsum("ik,k->i", design, miss) / noise, values

    def gain(self, normal: Floats, pull: Floats, values: float) -> float:
        """Return what a field of the second frame gains over motion of the probe by the information criterion, nats.

        Motion displaces whole rows, however uneven it is.

        Parameters
        ----------
        normal, pull, values
            As of :meth:`compare`.
        """
        size = self._prior.size
        normal, pull = normal[size:, size:], pull[size:]

        def left(some: NDArray[np.int64]) -> float:
            """Return the squared residuals that some coefficients leave."""
            part = normal[np.ix_(some, some)]
            step = np.linalg.solve(part + np.diag(self._prior.ravel()[some]), pull[some])
            return float(values - 2 * step @ pull[some] + step @ part @ step)

        every = np.arange(size)
        moved = every[np.tile(_powers()[1] == 0, 2)]
        return 0.5 * (values * log(left(moved) / left(every)) - (size - len(moved)) * log(values))

    def solve(
        self, image: Callable[[int], NDArray[np.float32]], poses: Sequence[Pose], pairs: Sequence[tuple[int, int]]
    ) -> None:
        """Fit the fields of all frames of a track by one step from where they are.

        Parameters
        ----------
        image : callable
            Returns the image (side, side) of a frame by its index.
        poses : sequence of Pose
            Of all frames.
        pairs : sequence of tuple of int
            Indices of frames that are compared, the first of each before the second.
        """
        frames = sorted({frame for pair in pairs for frame in pair})
        blocks: dict[tuple[int, int], Floats] = {}
        prior, pull = np.diag(self._prior.ravel()), np.zeros((len(frames), self._prior.size))
        number = {frame: k for k, frame in enumerate(frames)}
        for frame, k in number.items():
            blocks[k, k] = prior
            pull[k] = -(self._prior * self._field(frame)).ravel()
        for pair in pairs:
            first, last = pair
            found = self.compare((image(first), image(last)), pair, (poses[first], poses[last]))
            if found is None:
                continue
            normal, pulled, _ = found
            for i, rows in zip(pair, np.split(normal, 2), strict=True):
                for j, block in zip(pair, np.split(rows, 2, axis=1), strict=True):
                    blocks[number[i], number[j]] = blocks.get((number[i], number[j]), 0.0) + block
            for i, part in zip(pair, np.split(pulled, 2), strict=True):
                pull[number[i]] += part
        matrix = _assembled(blocks, len(frames))
        # frames that follow one another are solved for exactly, and what shows a place again is few
        along = splu(_assembled({at: blocks[at] for at in blocks if abs(at[0] - at[1]) < 2}, len(frames)).tocsc())
        inverse = LinearOperator(matrix.shape, along.solve)
        steps, _ = cg(matrix, pull.ravel(), rtol=_TOLERANCE, M=inverse)
        for frame, step in zip(frames, steps.reshape(len(frames), *self._prior.shape), strict=True):
            self._fields[frame] = self._field(frame) + step

    def settle(self, poses: Sequence[Pose]) -> None:
        """Take out of the fields of each segment what is the same at all times: it is the shape of its mosaic.

        Parameters
        ----------
        poses : sequence of Pose
            Of all frames.
        """
        across = np.linspace(-0.9, 0.9, _POINTS_ACROSS) * self._radius
        points = np.stack(np.meshgrid(across, across, indexing="ij"))
        points = points[:, self._within(points)]
        terms = self._terms(points)
        to_terms = np.linalg.pinv(terms)
        for segment in {poses[frame].segment for frame in self._fields}:
            frames = np.array([frame for frame in sorted(self._fields) if poses[frame].segment == segment])
            at = np.array([(poses[frame].row, poses[frame].col) for frame in frames])
            places = points.T + at[:, None]
            chosen = slice(None, None, ceil(len(frames) / _MAX_FRAMES))
            moved = np.array([(self._fields[frame] @ terms).T for frame in frames[chosen]])
            moved -= moved.mean(axis=(0, 1))  # the mosaic as a whole stays where it is
            known = places[chosen].reshape(-1, 2), frames[chosen].repeat(len(terms.T)), moved.reshape(-1, 2)
            still = static_part(*known, LENGTH_DIAMETERS * self._grid.diameter)
            for frame, place in zip(frames.tolist(), places, strict=True):
                self._fields[frame] = self._fields[frame] - still(place).T @ to_terms

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

    def _field(self, index: int) -> Floats:
        """Return the coefficients of a frame's field, (2, m); 0 before they are fitted."""
        return self._fields.get(index, np.zeros(self._prior.shape))

    def _within(self, points: Floats) -> NDArray[np.bool_]:
        """Return which points (2, ...) from the field's centre are compared."""
        return np.asarray(np.hypot(*points) < _MARGIN * self._radius)

    def _moved(self, index: int, at: Floats, terms: Floats) -> Floats:
        """Return where a frame shows what lies at points (2, n) from the centre, freed of its field; `terms` there."""
        moved = np.einsum("ij,jk->ik", self._field(index), terms)
        return np.asarray(at + moved + np.reshape(self._grid.centre, (2, 1)))

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


def _assembled(blocks: Mapping[tuple[int, int], Floats], count: int) -> sparse.bsr_array:
    """Return the sparse matrix of square blocks, given by their row and column among `count`."""
    places = sorted(blocks)
    rows, cols = np.array(places).T
    data = np.array([blocks[at] for at in places])
    side = count * data.shape[-1]
    return sparse.bsr_array((data, cols, np.searchsorted(rows, np.arange(count + 1))), shape=(side, side))


def legendre_terms(points: Floats) -> Floats:
    """Return the products of Legendre polynomials of rows and columns up to :data:`DEGREE`, (terms, ...).

    Parameters
    ----------
    points : numpy.ndarray
        (2, ...) rows and columns, from -1 to 1 across the field.
    """
    down, across = (np.moveaxis(legendre.legvander(axis, DEGREE), -1, 0) for axis in points)
    of_rows, of_cols = _powers()
    return np.asarray(down[of_rows] * across[of_cols], np.float64)


def _powers() -> NDArray[np.int64]:
    """Return the degrees of the terms in rows and in columns, (2, terms)."""
    return np.array([(i, j) for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)]).T


def _sampled(images: NDArray[Any], at: Floats) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return both channels of an image (rows, cols, 2) at points (2, ..., n) between its pixels."""
    rows, cols = at.astype(np.float32).reshape(2, -1, at.shape[-1])
    sampled = cv2.remap(images, cols, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    one, two = cv2.split(sampled)
    return np.reshape(one, at.shape[1:]), np.reshape(two, at.shape[1:])
