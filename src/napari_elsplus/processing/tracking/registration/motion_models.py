"""Score test for a rotation beside the rolling shutter's warp, and frames freed of it.

The rolling shutter's warp contains no rotation. One more pass over registered frames estimates what it would add to the
warp, with its uncertainty; ``registration.model_selection`` decides whether it is modelled. A rotated frame is rotated
back before it is registered, so that all else remains as for a probe that does not rotate.
"""

from __future__ import annotations

from enum import IntEnum
from math import inf
from typing import TYPE_CHECKING, Final, NamedTuple

import cv2
import numpy as np

from napari_elsplus.processing.compiled import lean_kernel
from napari_elsplus.processing.tracking.front_end.sampling import between, bilinear, neighbours, row_shift
from napari_elsplus.processing.tracking.motion.rolling_shutter import Warp
from napari_elsplus.processing.tracking.registration.similarity import tone_between

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.motion.rolling_shutter import Velocity

    Matrix = NDArray[np.float64]

_PARAMETERS: Final = [0, 1, 2, 3, 6]
"""Unknowns of the motion among those of :func:`fill_equations`; the others are gain and offset."""
_TURN: Final = 6
_RESIDUAL: Final = 7
_ROWS_AT_ONCE: Final = 8
"""Rows of which products are added up at once; chosen: what is kept of them stays in the processor's nearest cache."""


class MotionModel(IntEnum):
    """Motion that is modelled beside the rolling shutter's warp."""

    TRANSLATION = 0
    """Nothing."""
    RIGID = 1
    """The probe rotates."""


class Remainder(NamedTuple):
    """Score test of a registration: the change of the warp that a rotation would add.

    Parameters
    ----------
    step : numpy.ndarray
        (5,): change of a, b, s, d and of rows per column, which is the rotation in radians.
    sigma : float
        Standard deviation of the rotation, radians.
    values : float
        Independent values that were compared.
    """

    step: Matrix
    sigma: float
    values: float


def turned_by(angle: float) -> Matrix:
    """Return the matrix that turns (row, col) by an angle in radians, from rows towards columns."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])


def upright(
    image: NDArray[np.float32],
    out: NDArray[np.float32],
    centre: tuple[float, float],
    matrix: Matrix,
    shift: tuple[float, float] = (0.0, 0.0),
) -> NDArray[np.float32]:
    """Move every point of an image to `matrix` times where it was, about the bundle's centre; beyond it lies zero.

    Parameters
    ----------
    image, out : numpy.ndarray
        (n, n) float32; `out` is filled, by bilinear interpolation, and returned.
    centre : tuple of float
        Row and column of the bundle's centre.
    matrix : numpy.ndarray
        (2, 2), of (row, col).
    shift : tuple of float
        Rows and columns by which everything is moved besides, pixels.
    """
    row, col = centre
    (rr, rc), (cr, cc) = matrix
    down, across = row + shift[0], col + shift[1]
    forward = np.array([[cc, cr, across - cc * col - cr * row], [rc, rr, down - rc * col - rr * row]])
    size = (image.shape[1], image.shape[0])
    cv2.warpAffine(image, forward, size, dst=out, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
    return out


def unsheared(velocity: Velocity, line_periods_per_frame: float) -> Matrix:
    """Return the matrix that frees a frame of the stretch and shear that its motion gave it.

    Parameters
    ----------
    velocity : Velocity
        Of the probe while the frame is read.
    line_periods_per_frame : float
        In rows of the grid.
    """
    return np.array([[1 + velocity.row / line_periods_per_frame, 0.0], [velocity.col / line_periods_per_frame, 1.0]])


def composed(warp: Warp, step: Matrix) -> tuple[Warp, float]:
    """Return a warp to which a change was applied, and the rotation that is part of it.

    Parameters
    ----------
    warp : Warp
        That the frames were compared under.
    step : numpy.ndarray
        (5,): that of :class:`Remainder`.

    Returns
    -------
    warp : Warp
        From the earlier frame, rotated, to the later one.
    angle : float
        By which it is rotated, radians, as of :func:`turned_by`.

    Examples
    --------
    >>> warp, angle = composed(Warp(b=-20.0), np.array([0, 0, -0.01, 0, 0.01]))
    >>> round(float(np.rad2deg(angle)), 3), round(warp.s, 4), round(warp.b, 4)
    (0.573, 0.0, -20.0)
    """
    da, db, ds, dd, turn = step
    linear = np.array([[warp.a, 0.0], [warp.s, 1.0]]) @ np.linalg.inv(np.array([[1 + da, turn], [ds, 1.0]]))
    b, d = (warp.b, warp.d) - linear @ (db, dd)
    (m11, m12), (m21, m22) = linear
    angle = np.arctan2(-m12, m11)
    shear = m21 * np.cos(angle) - m22 * np.sin(angle)
    return Warp(float(np.hypot(m11, m12)), float(b), float(shear), float(d)), float(angle)


def remainder(
    template: NDArray[np.float32],
    image: NDArray[np.float32],
    first: NDArray[np.int32],
    last: NDArray[np.int32],
    middle: tuple[float, float],
    warp: Warp,
    px: float,
    stiffness: tuple[float, float],
    correlated_px: float,
    turn: tuple[float, float] = (0.0, inf),
) -> Remainder | None:
    """Estimate what a rotation would add to a warp.

    Parameters
    ----------
    template, image : numpy.ndarray
        (n, n) float32 frames.
    first, last : numpy.ndarray
        (n,) int32: lit columns of each row.
    middle : tuple of float
        Row and column of the bundle's centre.
    warp : Warp
        In pixels of full resolution.
    px : float
        Pixels of full resolution per pixel of these images.
    stiffness : tuple of float
        Information on a and s that is there beforehand.
    correlated_px : float
        Pixels of these images that share one noise value.
    turn : tuple of float
        Rotation that is expected, radians, and its standard deviation.

    Returns
    -------
    Remainder or None
        None where the frames do not overlap or show nothing.
    """
    scaled = np.array([warp.a, warp.b / px, warp.s, warp.d / px])
    tone = np.array(tone_between(template, image, first, last, middle[0], scaled, 4))
    columns = np.empty((_RESIDUAL + 1, _ROWS_AT_ONCE * len(template)), np.float32)
    sums = np.empty((_RESIDUAL + 1,) * 2)
    noise = correlated_px * fill_equations(template, image, first, last, *middle, scaled, tone, columns, sums)
    # variances of template and image, from the sums of what is left of the image
    of_tone, to_image = sums[np.ix_((4, 5, 7), (4, 5, 7))], np.array([*tone, 1.0])
    total, count = of_tone[1], of_tone[1, 1]
    if not noise > 0:
        return None
    variances = [of_tone[0, 0] - total[0] ** 2 / count, to_image @ of_tone @ to_image - (to_image @ total) ** 2 / count]
    if not min(variances) > 0:
        return None
    # a pixel of motion changes the image by the template's gradient times the gain
    gain = np.ones(_RESIDUAL)
    gain[_PARAMETERS] = np.sqrt(variances[1] / variances[0])
    normal, right = gain[:, None] * sums[:_RESIDUAL, :_RESIDUAL] * gain, gain * sums[:_RESIDUAL, _RESIDUAL]
    normal[0, 0] += stiffness[0] * noise
    normal[2, 2] += stiffness[1] * noise
    normal[_TURN, _TURN] += noise / turn[1] ** 2
    right[_TURN] += turn[0] * noise / turn[1] ** 2
    try:
        inverse = np.linalg.inv(normal)
    except np.linalg.LinAlgError:
        return None
    step = (inverse @ right)[_PARAMETERS] * (1, px, 1, px, 1)
    return Remainder(step, float(np.sqrt(max(noise * inverse[_TURN, _TURN], 0.0))), count / correlated_px)


@lean_kernel
def fill_equations(
    template: NDArray[np.float32],
    image: NDArray[np.float32],
    first: NDArray[np.int32],
    last: NDArray[np.int32],
    middle_row: float,
    middle_col: float,
    warp: NDArray[np.float64],
    tone: NDArray[np.float64],
    columns: NDArray[np.float32],
    sums: NDArray[np.float64],
) -> float:
    """Fill the normal equations of all unknowns about a warp; return the mean squared residual where structure is.

    Parameters
    ----------
    template, image, first, last, warp, tone
        As of :func:`~.lucas_kanade.accumulate`.
    middle_row, middle_col : float
        Bundle's centre.
    columns : numpy.ndarray
        (8, m) float32 scratch: of some rows the derivatives by a, b, s, d, gain, offset and rotation, and the residual.
    sums : numpy.ndarray
        (8, 8) float64, filled: the sum of the product of each two of these.
    """
    sums[:] = 0.0
    squares, half, height, filled = 0.0, np.float32(0.5), template.shape[0], 0
    gain, offset, one = np.float32(tone[0]), np.float32(tone[1]), np.float32(1)
    for row in range(1, height - 1):
        above, down, whole, across, begin, end = row_shift(row, height, middle_row, warp, first, last)
        size = end - begin
        here, corners = template[row, begin:end], neighbours(image, above, begin + whole, size)
        left, right_of = template[row, begin - 1 : end - 1], template[row, begin + 1 : end + 1]
        over, under = template[row - 1, begin:end], template[row + 1, begin:end]
        weights, y, x0 = bilinear(down, across), np.float32(row - middle_row), np.float32(begin - middle_col)
        by_a, by_b = columns[0, filled : filled + size], columns[1, filled : filled + size]
        by_s, by_d = columns[2, filled : filled + size], columns[3, filled : filled + size]
        by_gain, by_offset = columns[4, filled : filled + size], columns[5, filled : filled + size]
        by_turn, residual = columns[_TURN, filled : filled + size], columns[_RESIDUAL, filled : filled + size]
        total = np.float32(0)
        for k in range(size):  # loops with few arrays each, which the compiler can vectorise
            by_b[k], by_gain[k] = half * (under[k] - over[k]), here[k]
        for k in range(size):
            by_d[k], by_offset[k] = half * (right_of[k] - left[k]), one
        for k in range(size):
            residual[k] = between(corners, weights, k) - gain * here[k] - offset
        for k in range(size):
            by_a[k], by_s[k], by_turn[k] = y * by_b[k], y * by_d[k], (x0 + np.float32(k)) * by_b[k]
        for k in range(size):
            total += (by_b[k] * by_b[k] + by_d[k] * by_d[k]) * residual[k] * residual[k]
        squares += float(total)
        filled += size
        if filled + height > columns.shape[1]:
            _add_products(columns, filled, sums)
            filled = 0
    _add_products(columns, filled, sums)
    steep = sums[1, 1] + sums[3, 3]
    return squares / steep if steep > 0 else 0.0


@lean_kernel
def _add_products(columns: NDArray[np.float32], size: int, sums: NDArray[np.float64]) -> None:
    """Add the sum of the product of each two rows of an array, of which so many columns are filled."""
    for m in range(len(columns)):
        for n in range(m + 1):
            one, other, product = columns[m, :size], columns[n, :size], np.float32(0)
            for k in range(size):
                product += one[k] * other[k]
            sums[m, n] += float(product)
            sums[n, m] = sums[m, n]
