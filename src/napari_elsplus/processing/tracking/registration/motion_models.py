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
from napari_elsplus.processing.tracking.registration.similarity import tone_between

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.motion.rolling_shutter import Velocity

    Matrix = NDArray[np.float64]

_UNKNOWNS: Final = 8
"""a, b, s, d of the warp; rows from columns and columns from columns; gain and offset."""
_TONE: Final = 6
"""The first unknown that is no motion."""


class MotionModel(IntEnum):
    """Motion that is modelled beside the rolling shutter's warp."""

    TRANSLATION = 0
    """Nothing."""
    RIGID = 1
    """The probe rotates."""
    SIMILARITY = 2
    """The probe rotates, and its images change in scale."""


_FREE: Final = np.array([[n not in range(4 + model, 6) for n in range(_UNKNOWNS)] for model in MotionModel], np.float64)
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
    tilt = np.empty((3, template.shape[1]), np.float32)
    scaled = np.array([warp.a, warp.b / px, warp.s, warp.d / px])
    count, noise = unexplained(template, image, first, last, *middle, scaled, tilt, normal, right)
    if not (count > 0 and noise > 0):
        return None
    noise *= correlated_px
    normal[0, 0] += stiffness[0] * noise
    normal[2, 2] += stiffness[1] * noise
    normal[4, 4] += noise / turn[1] ** 2
    right[4] += turn[0] * noise / turn[1] ** 2
    try:
        inverse = np.linalg.inv(normal * _FREE_PAIRS + _HELD_AT_ZERO)
    except np.linalg.LinAlgError:
        return None
    step = (inverse @ (right * _FREE)[..., None])[:, :6, 0]
    covariance = inverse[MotionModel.SIMILARITY] * noise
    step[:, [1, 3]] *= px
    sigma = np.sqrt(np.maximum(covariance.diagonal()[4:6], 0))
    return Remainder(step, sigma, count / correlated_px)


@lean_kernel
def unexplained(
    template: NDArray[np.float32],
    image: NDArray[np.float32],
    first: NDArray[np.int32],
    last: NDArray[np.int32],
    middle_row: float,
    middle_col: float,
    warp: NDArray[np.float64],
    tilt: NDArray[np.float32],
    normal: NDArray[np.float64],
    right: NDArray[np.float64],
) -> tuple[float, float]:
    """Fill the normal equations of a, b, s, d, rotation and scale, gain and offset about a warp.

    `tilt` is scratch of three rows of an image.

    Returns the number of pixels, and the mean squared difference weighted by the squared gradient.

    Parameters
    ----------
    template, image : numpy.ndarray
        (n, n) float32 frames: the earlier one, and the later one that is sampled under the warp.
    first, last : numpy.ndarray
        (n,) int32: first lit column of each row, and the one after the last.
    middle_row, middle_col : float
        Bundle's centre.
    warp : numpy.ndarray
        (4,) a, b, s, d.
    tilt : numpy.ndarray
        (3, n) float32 scratch.
    normal, right : numpy.ndarray
        (8, 8) and (8,) float64, filled.
    """
    normal[:] = 0.0
    right[:] = 0.0
    height = template.shape[0]
    gain, offset = tone_between(template, image, first, last, middle_row, warp, 4)
    count, steep, noise_level, sum_ee = 0.0, 0.0, 0.0, 0.0
    for row in range(1, height - 1):
        above, down, whole, across, begin, end = row_shift(row, height, middle_row, warp, first, last)
        if end <= begin:
            continue
        size = end - begin
        here, corners = template[row, begin:end], neighbours(image, above, begin + whole, size)
        left, right_of = template[row, begin - 1 : end - 1], template[row, begin + 1 : end + 1]
        over, under = template[row - 1, begin:end], template[row + 1, begin:end]
        weights = bilinear(down, across)
        rows, cols, miss = tilt[0, :size], tilt[1, :size], tilt[2, :size]
        x0 = np.float32(begin - middle_col)
        half, g, o = np.float32(0.5), np.float32(gain), np.float32(offset)
        zero = np.float32(0)
        yy, yx, xx, y1, x1, yt, xt, ye, xe = zero, zero, zero, zero, zero, zero, zero, zero, zero
        t1, e1, tt, te, ee, gg = zero, zero, zero, zero, zero, zero
        for k in range(size):
            t = here[k]
            gy, gx = half * (under[k] - over[k]), half * (right_of[k] - left[k])
            e = between(corners, weights, k) - g * t - o
            rows[k], cols[k], miss[k] = gy, gx, e
            yy += gy * gy
            yx += gy * gx
            xx += gx * gx
            y1 += gy
            x1 += gx
            yt += gy * t
            xt += gx * t
            ye += gy * e
            xe += gx * e
            t1 += t
            e1 += e
            tt += t * t
            te += t * e
            ee += e * e
            gg += (gy * gy + gx * gx) * e * e
        uyy, uyx, uxx, uy1, ux1 = zero, zero, zero, zero, zero
        uyt, uxt, uye, uxe, vyy, vyx, vxx = zero, zero, zero, zero, zero, zero, zero
        for k in range(size):
            x = x0 + np.float32(k)
            gy, gx, e = rows[k], cols[k], miss[k]
            uy, ux = x * gy, x * gx
            uyy += uy * gy
            uyx += uy * gx
            uxx += ux * gx
            uy1 += uy
            ux1 += ux
            uyt += uy * here[k]
            uxt += ux * here[k]
            uye += uy * e
            uxe += ux * e
            vyy += uy * uy
            vyx += uy * ux
            vxx += ux * ux
        y = row - middle_row
        count += size
        steep += float(yy) + float(xx)
        noise_level += float(gg)
        sum_ee += float(ee)
        normal[0, 0] += y * y * yy
        normal[0, 1] += y * yy
        normal[0, 2] += y * y * yx
        normal[0, 3] += y * yx
        normal[0, 4] += y * uyy
        normal[0, 5] += y * uyx
        normal[0, 6] += y * yt
        normal[0, 7] += y * y1
        normal[1, 1] += yy
        normal[1, 2] += y * yx
        normal[1, 3] += yx
        normal[1, 4] += uyy
        normal[1, 5] += uyx
        normal[1, 6] += yt
        normal[1, 7] += y1
        normal[2, 2] += y * y * xx
        normal[2, 3] += y * xx
        normal[2, 4] += y * uyx
        normal[2, 5] += y * uxx
        normal[2, 6] += y * xt
        normal[2, 7] += y * x1
        normal[3, 3] += xx
        normal[3, 4] += uyx
        normal[3, 5] += uxx
        normal[3, 6] += xt
        normal[3, 7] += x1
        normal[4, 4] += vyy
        normal[4, 5] += vyx
        normal[4, 6] += uyt
        normal[4, 7] += uy1
        normal[5, 5] += vxx
        normal[5, 6] += uxt
        normal[5, 7] += ux1
        normal[6, 6] += tt
        normal[6, 7] += t1
        normal[7, 7] += size
        right[0] += y * ye
        right[1] += ye
        right[2] += y * xe
        right[3] += xe
        right[4] += uye
        right[5] += uxe
        right[6] += te
        right[7] += e1
    if count == 0 or steep == 0:
        return 0.0, 0.0
    of_template = normal[6, 6] - normal[6, 7] ** 2 / count
    of_both = gain * of_template + right[6] - normal[6, 7] * right[7] / count
    of_image = gain * (2 * of_both - gain * of_template) + sum_ee - right[7] ** 2 / count
    if not (of_template > 0 and of_image > 0):
        return 0.0, 0.0
    contrast = np.sqrt(of_image / of_template)  # what a pixel of motion does to the image, over the template's gradient
    for m in range(_TONE):
        right[m] *= contrast
        for n in range(m, _UNKNOWNS):
            normal[m, n] *= contrast * contrast if n < _TONE else contrast
    for m in range(_UNKNOWNS):
        for n in range(m):
            normal[m, n] = normal[n, m]
    return count, noise_level / steep
