"""Score test for rotation and scale beside the rolling shutter's warp, and frames freed of both.

The rolling shutter's warp contains no rotation and no change of scale. One more pass over registered frames estimates
what these would add to the warp, with its uncertainty; ``registration.model_selection`` decides whether they are
modelled. A rotated frame is rotated back before it is registered, so that all else remains as for a probe that does not
rotate.
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
from napari_elsplus.processing.tracking.registration.lucas_kanade import accumulate
from napari_elsplus.processing.tracking.registration.similarity import tone_between

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.motion.rolling_shutter import Velocity

    Matrix = NDArray[np.float64]

_UNKNOWNS: Final = 8
"""a, b, s, d of the warp; gain and offset; rows from columns and columns from columns."""
_TURN: Final = 6
_SCALE: Final = 7
_OF_TONE: Final = (4, 5)
_OF_MOTION: Final = [n for n in range(_UNKNOWNS) if n not in _OF_TONE]
_SAMPLING: Final = (1, False)
"""Every how many rows are used, and whether they are sampled finely: variables in a kernel, as in ``odds``."""


class MotionModel(IntEnum):
    """Motion that is modelled beside the rolling shutter's warp."""

    TRANSLATION = 0
    """Nothing."""
    RIGID = 1
    """The probe rotates."""
    SIMILARITY = 2
    """The probe rotates, and its images change in scale."""


_FREE: Final = np.array(
    [[n not in range(_TURN + model, _UNKNOWNS) for n in range(_UNKNOWNS)] for model in MotionModel], np.float64
)
_FREE_PAIRS: Final = _FREE[:, :, None] * _FREE[:, None, :]
_HELD_AT_ZERO: Final = (1 - _FREE[:, :, None]) * np.eye(_UNKNOWNS)
"""Unknowns that each model leaves free, and the equations that hold the others at zero."""


class Remainder(NamedTuple):
    """Score test of a registration: the change of the warp that each model would add.

    Parameters
    ----------
    step : numpy.ndarray
        (3, 6): for each model the change of a, b, s, d, of rows per column and of columns per column, each at its best;
        what a model does not model is zero.
    sigma : numpy.ndarray
        (2,) standard deviations of the rotation (radians) and of the scale, as parts of one.
    values : float
        Independent values that were compared.
    """

    step: Matrix
    sigma: Matrix
    values: float


def turned_by(angle: float, scale: float = 1.0) -> Matrix:
    """Return the matrix that turns (row, col) by an angle in radians, from rows towards columns, and scales it."""
    c, s = scale * np.cos(angle), scale * np.sin(angle)
    return np.array([[c, -s], [s, c]])


def angle_of(form: Matrix) -> float:
    """Angle of :func:`turned_by`."""
    return float(np.arctan2(form[1, 0] - form[0, 1], form[0, 0] + form[1, 1]))


def scale_of(form: Matrix) -> float:
    """Scale of :func:`turned_by`."""
    return float(np.sqrt(abs(np.linalg.det(form))))


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


def composed(warp: Warp, step: Matrix) -> tuple[Warp, Matrix]:
    """Return a warp to which a change was applied, and the rotation and scale of that change.

    Parameters
    ----------
    warp : Warp
        That the frames were compared under.
    step : numpy.ndarray
        (6,): one model's of :class:`Remainder`.

    Returns
    -------
    warp : Warp
        From the earlier frame, turned and scaled by the form, to the later one.
    form : numpy.ndarray
        (2, 2) rotation and scale.

    Examples
    --------
    >>> warp, form = composed(Warp(b=-20.0), np.array([0, 0, -0.01, 0, 0.01, 0]))
    >>> round(float(np.rad2deg(angle_of(form))), 3), round(warp.s, 4), round(warp.b, 4)
    (0.573, 0.0, -20.0)
    """
    da, db, ds, dd, de, df = step
    linear = np.array([[warp.a, 0.0], [warp.s, 1.0]]) @ np.linalg.inv(np.array([[1 + da, de], [ds, 1 + df]]))
    shift = np.array([warp.b, warp.d]) - linear @ (db, dd)
    (m11, m12), (m21, m22) = linear
    angle = np.arctan2(-m12, m11)
    c, s = np.cos(angle), np.sin(angle)
    scale = m21 * s + m22 * c if df else 1.0  # what a turn alone leaves there is of second order
    stretch, shear = float(np.hypot(m11, m12) / scale), float((m21 * c - m22 * s) / scale)
    found = Warp(stretch, float(shift[0]), shear, float(shift[1]))
    return found, turned_by(float(angle), float(scale))


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
    """Estimate what rotation and scale would add to a warp.

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
    normal, right = np.empty((_UNKNOWNS, _UNKNOWNS)), np.empty(_UNKNOWNS)
    scaled = np.array([warp.a, warp.b / px, warp.s, warp.d / px])
    tone, samples = np.empty(3), np.empty((2, template.shape[1]), np.float32)
    count, noise = fill_equations(template, image, first, last, *middle, scaled, tone, samples, normal, right)
    if not noise > 0:
        return None
    noise *= correlated_px
    normal[0, 0] += stiffness[0] * noise
    normal[2, 2] += stiffness[1] * noise
    normal[_TURN, _TURN] += noise / turn[1] ** 2
    right[_TURN] += turn[0] * noise / turn[1] ** 2
    try:
        inverse = np.linalg.inv(normal * _FREE_PAIRS + _HELD_AT_ZERO)
    except np.linalg.LinAlgError:
        return None
    step = (inverse @ (right * _FREE)[..., None])[:, _OF_MOTION, 0]
    covariance = inverse[MotionModel.SIMILARITY] * noise
    step[:, [1, 3]] *= px
    sigma = np.sqrt(np.maximum(covariance.diagonal()[_TURN:], 0))
    return Remainder(step, sigma, count / correlated_px)


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
    samples: NDArray[np.float32],
    normal: NDArray[np.float64],
    right: NDArray[np.float64],
) -> tuple[float, float]:
    """Fill the normal equations of all unknowns about a warp; return the number of pixels and the noise level.

    Parameters
    ----------
    template, image, first, last, warp, tone, samples
        As of :func:`~.lucas_kanade.accumulate`; `tone` is filled.
    middle_row, middle_col : float
        Bundle's centre.
    normal, right : numpy.ndarray
        (8, 8) and (8,) float64, filled.
    """
    row_step, finely = _SAMPLING
    tone[0], tone[1] = tone_between(template, image, first, last, middle_row, warp, 4 * row_step)
    count, of_template, of_image, _, noise = accumulate(
        template, image, first, last, middle_row, warp, tone, row_step, finely, normal, right, samples
    )
    if not (of_template > 0 and of_image > 0):
        return 0.0, 0.0
    add_turn(template, image, first, last, middle_row, middle_col, warp, tone, normal, right)
    contrast = np.sqrt(of_image / of_template)  # what a pixel of motion does to the image, over the template's gradient
    for m in range(_UNKNOWNS):
        if m in _OF_TONE:
            continue
        right[m] *= contrast
        for n in range(_UNKNOWNS):
            normal[m, n] *= contrast
            normal[n, m] *= contrast
    return count, noise


@lean_kernel
def add_turn(
    template: NDArray[np.float32],
    image: NDArray[np.float32],
    first: NDArray[np.int32],
    last: NDArray[np.int32],
    middle_row: float,
    middle_col: float,
    warp: NDArray[np.float64],
    tone: NDArray[np.float64],
    normal: NDArray[np.float64],
    right: NDArray[np.float64],
) -> None:
    """Add rotation and scale to the normal equations of :func:`~.lucas_kanade.accumulate`.

    Parameters
    ----------
    template, image, first, last, warp, tone
        As there.
    middle_row, middle_col : float
        Bundle's centre.
    normal, right : numpy.ndarray
        (8, 8) and (8,) float64, of which the last two rows and columns are filled.
    """
    height, half = template.shape[0], np.float32(0.5)
    gain, offset = np.float32(tone[0]), np.float32(tone[1])
    for row in range(1, height - 1):
        above, down, whole, across, begin, end = row_shift(row, height, middle_row, warp, first, last)
        size = end - begin
        here, corners = template[row, begin:end], neighbours(image, above, begin + whole, size)
        left, right_of = template[row, begin - 1 : end - 1], template[row, begin + 1 : end + 1]
        over, under = template[row - 1, begin:end], template[row + 1, begin:end]
        weights, x0, zero = bilinear(down, across), np.float32(begin - middle_col), np.float32(0)
        yy, yx, xx, y1, x1, yt, xt, ye, xe = zero, zero, zero, zero, zero, zero, zero, zero, zero
        vyy, vyx, vxx = zero, zero, zero
        for k in range(size):
            x, t = x0 + np.float32(k), here[k]
            gy, gx = half * (under[k] - over[k]), half * (right_of[k] - left[k])
            e = between(corners, weights, k) - gain * t - offset
            uy, ux = x * gy, x * gx
            yy += uy * gy
            yx += uy * gx
            xx += ux * gx
            y1 += uy
            x1 += ux
            yt += uy * t
            xt += ux * t
            ye += uy * e
            xe += ux * e
            vyy += uy * uy
            vyx += uy * ux
            vxx += ux * ux
        y = row - middle_row
        for unknown, of_rows, of_cols, of_t, of_1 in ((_TURN, yy, yx, yt, y1), (_SCALE, yx, xx, xt, x1)):
            normal[unknown, 0] += y * of_rows
            normal[unknown, 1] += of_rows
            normal[unknown, 2] += y * of_cols
            normal[unknown, 3] += of_cols
            normal[unknown, 4] += of_t
            normal[unknown, 5] += of_1
        normal[_TURN, _TURN] += vyy
        normal[_SCALE, _TURN] += vyx
        normal[_SCALE, _SCALE] += vxx
        right[_TURN] += ye
        right[_SCALE] += xe
    for m in (_TURN, _SCALE):
        for n in range(m):
            normal[n, m] = normal[m, n]
