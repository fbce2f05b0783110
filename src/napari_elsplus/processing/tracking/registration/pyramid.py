"""Pyramid of a tracking image: itself, and its high-passed halves and quarters.

What is smooth is estimated at a quarter of the resolution by a Gaussian normalised within the lit disc, interpolated
between its pixels, and subtracted. It contains the glow at the rim, where the line has left the bundle while the
residual is read.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import cv2
import numpy as np

from napari_elsplus.processing.compiled import lean_kernel
from napari_elsplus.processing.tracking.front_end.grid import lit_pixels

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.front_end.grid import Grid

    Image = NDArray[np.float32]
    Columns = tuple[NDArray[np.int32], NDArray[np.int32]]

LEVELS: Final = 3
HIGH_PASS_PX: Final = 8.0
"""Standard deviation of the Gaussian whose result is subtracted from images, pixels of full resolution."""
_REACH: Final = 5
"""Pixels of quarter resolution to which it extends: two and a half standard deviations."""


class Levels(NamedTuple):
    """Arrays of a frame; those beside the image are filled when a registration first needs them.

    Parameters
    ----------
    images : tuple of numpy.ndarray
        (n, n) float32 at full, half and quarter resolution; the latter two are high-passed.
    smooth : numpy.ndarray
        (n, n) float32: what is smooth at half resolution.
    high_passed : numpy.ndarray
        (n, n) float32: the image, high-passed.
    filled : numpy.ndarray
        (2,) bool: the coarser images, and the high-passed one, are filled.
    """

    images: tuple[Image, ...]
    smooth: Image
    high_passed: Image
    filled: NDArray[np.bool_]

    @classmethod
    def of(cls, side: int) -> Levels:
        """Return those of an image of so many rows and columns, `side`."""
        images = tuple(np.zeros((side >> level, side >> level), np.float32) for level in range(LEVELS))
        return cls(images, np.zeros_like(images[1]), np.zeros_like(images[0]), np.zeros(2, np.bool_))


class Pyramid(NamedTuple):
    """What filling the levels of frames on one grid needs; one for each thread.

    Parameters
    ----------
    lit : tuple of tuple of numpy.ndarray
        At each level (n,) int32: first lit column of each row, and the one after the last.
    taps : tuple of numpy.float32
        Gaussian: its middle, and one side.
    inverse : numpy.ndarray
        (n, n) float32 at quarter resolution: reciprocal of the lit part under the Gaussian.
    padded, coarse, lines : numpy.ndarray
        float32 scratch: lit pixels at quarter resolution, zero around them, and a line; what is smooth of them; and
        lines of full resolution.
    """

    lit: tuple[Columns, ...]
    taps: tuple[np.float32, ...]
    inverse: Image
    padded: Image
    coarse: Image
    lines: Image

    @classmethod
    def of(cls, grid: Grid, field: float) -> Pyramid:
        """Return one for frames on a grid that are lit in the central part of the disc.

        Parameters
        ----------
        grid : Grid
            The grid of the tracking images.
        field : float
            Part of the diameter: dark pixels beyond it would leave a static rim.
        """
        lit = tuple(grid.spans(field, level) for level in range(LEVELS))
        gaussian = cv2.getGaussianKernel(2 * _REACH + 1, HIGH_PASS_PX / 2 ** (LEVELS - 1), cv2.CV_32F)
        inside = lit_pixels(*lit[-1]).astype(np.float32)
        share, padded = np.zeros_like(inside), np.pad(0 * inside, ((_REACH, _REACH + 1), (_REACH, _REACH)))
        pyramid = cls(
            lit, tuple(gaussian[_REACH:, 0]), np.ones_like(inside), padded, share, np.zeros((3, grid.side), np.float32)
        )
        smooth_within(inside, pyramid)
        return pyramid._replace(inverse=np.reciprocal(np.maximum(share, np.float32(1e-3))))


@lean_kernel
def fill_levels(frame: Levels, pyramid: Pyramid) -> None:
    """Fill half and quarter resolution, high-passed, if they are not.

    Parameters
    ----------
    frame : Levels
        Of which the image is given.
    pyramid : Pyramid
        For frames on this grid.
    """
    if frame.filled[0]:
        return
    image, half, quarter = frame.images
    halve(image, half)
    halve(half, quarter)
    smooth_within(quarter, pyramid)
    double(pyramid.coarse, pyramid.lines, frame.smooth)
    subtract_within(half, frame.smooth, pyramid.lit[1], half)
    halve(half, quarter)
    frame.filled[0] = True


@lean_kernel
def high_pass(frame: Levels, pyramid: Pyramid) -> None:
    """Fill the high-passed image of full resolution if it is not; parameters as of :func:`fill_levels`."""
    if frame.filled[1]:
        return
    double(frame.smooth, pyramid.lines, frame.high_passed)
    subtract_within(frame.images[0], frame.high_passed, pyramid.lit[0], frame.high_passed)
    frame.filled[1] = True


@lean_kernel
def halve(fine: Image, coarse: Image) -> None:
    """Fill an image with the means of two by two pixels of one of twice its resolution.

    Parameters
    ----------
    fine, coarse : numpy.ndarray
        float32, `coarse` filled.
    """
    quarter = np.float32(0.25)
    for row in range(coarse.shape[0]):
        upper, lower, into = fine[2 * row], fine[2 * row + 1], coarse[row]
        for col in range(coarse.shape[1]):
            into[col] = quarter * (upper[2 * col] + upper[2 * col + 1] + lower[2 * col] + lower[2 * col + 1])


@lean_kernel
def smooth_within(image: Image, pyramid: Pyramid) -> None:
    """Blur the lit pixels of an image of quarter resolution into the pyramid's scratch.

    Parameters
    ----------
    image : numpy.ndarray
        (n, n) float32.
    pyramid : Pyramid
        Its `coarse` is filled.
    """
    size, padded, (first, last) = len(image), pyramid.padded, pyramid.lit[2]
    for row in range(size):
        here, into = image[row], padded[_REACH + row, _REACH:]
        for col in range(np.uint32(first[row]), np.uint32(last[row])):
            into[col] = here[col]
    line = padded[2 * _REACH + size]
    down = line[_REACH : _REACH + size]
    for row in range(size):
        v0, v1, v2 = padded[row, _REACH:], padded[row + 1, _REACH:], padded[row + 2, _REACH:]
        v3, v4, v5 = padded[row + 3, _REACH:], padded[row + 4, _REACH:], padded[row + 5, _REACH:]
        v6, v7, v8 = padded[row + 6, _REACH:], padded[row + 7, _REACH:], padded[row + 8, _REACH:]
        rows = v0, v1, v2, v3, v4, v5, v6, v7, v8, padded[row + 9, _REACH:], padded[row + 10, _REACH:]
        for k in range(size):
            down[k] = _weighed(rows, pyramid.taps, k)
        l1, l2, l3, l4, l5 = line[1:], line[2:], line[3:], line[4:], line[5:]
        columns = line, l1, l2, l3, l4, l5, line[6:], line[7:], line[8:], line[9:], line[10:]
        into, factor = pyramid.coarse[row], pyramid.inverse[row]
        for k in range(size):
            into[k] = factor[k] * _weighed(columns, pyramid.taps, k)


@lean_kernel
def _weighed(runs: tuple[Image, ...], taps: tuple[np.float32, ...], k: int) -> np.float32:
    """Return the weighted sum of element k of eleven runs of pixels."""
    near = taps[0] * runs[5][k] + taps[1] * (runs[4][k] + runs[6][k]) + taps[2] * (runs[3][k] + runs[7][k])
    far = taps[3] * (runs[2][k] + runs[8][k]) + taps[4] * (runs[1][k] + runs[9][k])
    result: np.float32 = near + far + taps[5] * (runs[0][k] + runs[10][k])
    return result


@lean_kernel
def double(coarse: Image, lines: Image, out: Image) -> None:
    """Interpolate an image to twice its resolution.

    Parameters
    ----------
    coarse : numpy.ndarray
        (n, n) float32.
    lines : numpy.ndarray
        (3, 2 n) float32 scratch, or larger.
    out : numpy.ndarray
        (2 n, 2 n) float32, filled.
    """
    size, near, far = len(coarse), np.float32(0.75), np.float32(0.25)
    for row in range(size + 1):
        if row < size:
            here, line = coarse[row], lines[row % 3]
            line[0], line[2 * size - 1] = here[0], here[size - 1]
            left, right, into = here[: size - 1], here[1:size], line[1 : 2 * size - 1]
            for k in range(size - 1):
                into[2 * k] = near * left[k] + far * right[k]
                into[2 * k + 1] = far * left[k] + near * right[k]
        if row > 0:
            above, at, below = lines[max(row - 2, 0) % 3], lines[(row - 1) % 3], lines[min(row, size - 1) % 3]
            upper, lower = out[2 * row - 2], out[2 * row - 1]
            for col in range(2 * size):
                upper[col] = near * at[col] + far * above[col]
                lower[col] = near * at[col] + far * below[col]


@lean_kernel
def subtract_within(image: Image, other: Image, lit: Columns, out: Image) -> None:
    """Subtract one image from another where it is lit; zero elsewhere.

    Parameters
    ----------
    image, other, out : numpy.ndarray
        (n, n) float32; `out`, filled, may be one of the others.
    lit : tuple of numpy.ndarray
        (n,) int32: first lit column of each row, and the one after the last.
    """
    first, last = lit
    for row in range(len(image)):
        begin, end = first[row], last[row]
        here, there, into = image[row, begin:end], other[row, begin:end], out[row, begin:end]
        for k in range(end - begin):
            into[k] = here[k] - there[k]
        out[row, :begin] = np.float32(0)
        out[row, end:] = np.float32(0)
