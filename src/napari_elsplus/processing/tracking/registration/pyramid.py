"""Pyramid of a tracking image: itself, and its high-passed halves and quarters.

What is smooth is estimated at a quarter of the resolution by a Gaussian normalised within the lit disc, interpolated
between its pixels, and subtracted. It contains the glow at the rim, where the line has left the bundle while the
residual is read.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import cv2
import numpy as np

from napari_elsplus.processing.compiled import compilable, lean_kernel
from napari_elsplus.processing.tracking.front_end.grid import lit_pixels

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.front_end.grid import Grid

    Image = NDArray[np.float32]

LEVELS: Final = 3
HIGH_PASSED: Final = LEVELS
"""Index of the high-passed image of full resolution among the images of a frame: after those of all levels."""
HIGH_PASS_PX: Final = 8.0
"""Standard deviation of the Gaussian whose result is subtracted from images, pixels of full resolution."""
_REACH: Final = 5
"""Pixels of quarter resolution to which it extends: two and a half standard deviations."""
_TAPS: Final = tuple(cv2.getGaussianKernel(2 * _REACH + 1, HIGH_PASS_PX / 2 ** (LEVELS - 1), cv2.CV_32F)[_REACH:, 0])
"""The Gaussian: its middle, and one side."""
_WHOLE_PX: Final = 16
"""Pixels of a vector: loops over a multiple of it have no remainder, for which pixels are added one by one."""


class Levels(NamedTuple):
    """Arrays of a frame; those beside the image are filled when a registration first needs them.

    Parameters
    ----------
    images : tuple of numpy.ndarray
        (n, n) float32 at full, half and quarter resolution, of which the latter two are high-passed; and the image of
        full resolution, high-passed: :data:`HIGH_PASSED`.
    smooth : numpy.ndarray
        (n, n) float32: what is smooth at half resolution.
    filled : numpy.ndarray
        (2,) bool: the coarser images, and the high-passed one, are filled.
    """

    images: tuple[Image, ...]
    smooth: Image
    filled: NDArray[np.bool_]

    @classmethod
    def of(cls, side: int) -> Levels:
        """Return those of an image of so many rows and columns, `side`."""
        images = tuple(np.zeros((side >> level, side >> level), np.float32) for level in (*range(LEVELS), 0))
        return cls(images, np.zeros_like(images[1]), np.zeros(2, np.bool_))


class Pyramid(NamedTuple):
    """What filling the levels of frames on one grid needs; one for each thread.

    Parameters
    ----------
    lit : tuple of numpy.ndarray
        At each level (n, n) bool: the lit pixels.
    inverse : numpy.ndarray
        (n, m) float32 at quarter resolution: reciprocal of the lit part under the Gaussian.
    padded, blurred, coarse : numpy.ndarray
        float32 scratch of m columns, which end in a margin as wide as the Gaussian reaches: lit pixels at quarter
        resolution, with as many rows of margin on either side; the same blurred along columns; and what is smooth.
    lines, half, fine : numpy.ndarray
        float32 scratch: rows of twice as many columns, n rows at half resolution; an image of half and one of full
        resolution.
    """

    lit: tuple[NDArray[np.bool_], ...]
    inverse: Image
    padded: Image
    blurred: Image
    coarse: Image
    lines: Image
    half: Image
    fine: Image

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
        lit = tuple(lit_pixels(*grid.binned(2**level).spans(field)) for level in range(LEVELS))
        inside = lit[-1].astype(np.float32)
        size = len(inside)
        columns = -(-(size + _REACH) // _WHOLE_PX) * _WHOLE_PX
        padded, blurred = (np.zeros((size + 2 * _REACH, columns), np.float32) for _ in range(2))
        share = np.zeros((size, columns), np.float32)
        lines, half, fine = (
            np.zeros((grid.side >> level, grid.side >> over), np.float32) for level, over in ((1, 0), (1, 1), (0, 0))
        )
        pyramid = cls(lit, np.ones_like(share), padded, blurred, share, lines, half, fine)
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
    image, half, quarter, _ = frame.images
    halve(image, pyramid.half)
    halve(pyramid.half, quarter)
    smooth_within(quarter, pyramid)
    double(pyramid.coarse, pyramid.lines, frame.smooth)
    subtract_within(pyramid.half, frame.smooth, pyramid.lit[1], half)
    halve(half, quarter)
    frame.filled[0] = True


@lean_kernel
def high_pass(frame: Levels, pyramid: Pyramid) -> None:
    """Fill the high-passed image of full resolution if it is not; parameters as of :func:`fill_levels`."""
    if frame.filled[1]:
        return
    double(frame.smooth, pyramid.lines, pyramid.fine)
    subtract_within(frame.images[0], pyramid.fine, pyramid.lit[0], frame.images[HIGH_PASSED])
    frame.filled[1] = True


@compilable
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
    for row in range(len(image)):
        here, lit, into = image[row], pyramid.lit[2][row], pyramid.padded[_REACH + row]
        for col in range(len(image)):
            into[col] = here[col] if lit[col] else np.float32(0)
    columns, smooth, inverse = pyramid.coarse.shape[1], pyramid.coarse.reshape(-1), pyramid.inverse.reshape(-1)
    # rows are joined by their margins, so that either direction is one run of pixels
    blurred = pyramid.blurred.reshape(-1)
    _blur(pyramid.padded.reshape(-1), columns, blurred[_REACH : _REACH + len(smooth)])
    _blur(blurred, 1, smooth)
    for k in range(len(smooth)):
        smooth[k] *= inverse[k]


@compilable
def _blur(pixels: Image, apart: int, out: Image) -> None:
    """Fill a run of pixels with the weighted sums of eleven that lie so far `apart`, the first at the run's beginning.

    Parameters
    ----------
    pixels : numpy.ndarray
        (n,) float32.
    apart : int
        Pixels from one to the next.
    out : numpy.ndarray
        (m,) float32, filled.
    """
    p0, p1, p2, p3 = pixels, pixels[apart:], pixels[2 * apart :], pixels[3 * apart :]
    p4, p5, p6, p7 = pixels[4 * apart :], pixels[5 * apart :], pixels[6 * apart :], pixels[7 * apart :]
    p8, p9, p10 = pixels[8 * apart :], pixels[9 * apart :], pixels[10 * apart :]
    for k in range(len(out)):
        near = _TAPS[0] * p5[k] + _TAPS[1] * (p4[k] + p6[k]) + _TAPS[2] * (p3[k] + p7[k])
        far = _TAPS[3] * (p2[k] + p8[k]) + _TAPS[4] * (p1[k] + p9[k])
        out[k] = near + far + _TAPS[5] * (p0[k] + p10[k])


@compilable
def double(coarse: Image, lines: Image, out: Image) -> None:
    """Interpolate an image to twice its resolution.

    Parameters
    ----------
    coarse : numpy.ndarray
        (n, n) float32; further columns are not used.
    lines : numpy.ndarray
        (n, 2 n) float32 scratch, or larger.
    out : numpy.ndarray
        (2 n, 2 n) float32, filled.
    """
    size, near, far = len(coarse), np.float32(0.75), np.float32(0.25)
    for row in range(size):
        here, line = coarse[row], lines[row]
        line[0], line[2 * size - 1] = here[0], here[size - 1]
        left, right, into = here[: size - 1], here[1:size], line[1 : 2 * size - 1]
        for k in range(size - 1):
            into[2 * k] = near * left[k] + far * right[k]
            into[2 * k + 1] = far * left[k] + near * right[k]
    for row in range(2 * size):
        nearest = row // 2
        other = min(max(nearest + 2 * (row % 2) - 1, 0), size - 1)
        here, beside, into = lines[nearest], lines[other], out[row]
        for col in range(2 * size):
            into[col] = near * here[col] + far * beside[col]


@compilable
def subtract_within(image: Image, smooth: Image, lit: NDArray[np.bool_], out: Image) -> None:
    """Subtract what is smooth from an image where it is lit; zero elsewhere.

    Parameters
    ----------
    image, smooth, out : numpy.ndarray
        (n, n) float32; `out`, filled, is none of the others, lest pixels be subtracted one by one.
    lit : numpy.ndarray
        (n, n) bool.
    """
    pixels, less, inside, into = image.reshape(-1), smooth.reshape(-1), lit.reshape(-1), out.reshape(-1)
    for k in range(len(into)):
        into[k] = pixels[k] - less[k] if inside[k] else np.float32(0)
