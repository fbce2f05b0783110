"""Whether the probe turns: a score test for a rotation beside the rolling shutter's warp, and frames freed of it.

The rolling shutter's warp contains no rotation. One more pass over registered frames estimates what it would add to the
warp, with its uncertainty; and beside it a stretch of the columns, which neither motion nor rotation makes. This is the
control: it tells how far errors that are no noise, of tissue that deforms or of optics that distort, put out the
rotation as well. Whether rotation is modelled is decided by the Bayesian information criterion over many registrations
together: a slow rotation is significant in no single one but in their sum, which grows faster than its uncertainty. One
that sets in is sought from every registration on, so that those before do not hide it. A rotated frame is rotated back
before it is registered, so that all else remains as for a probe that does not rotate.

References
----------
Schwarz, Ann. Stat. 6, 461 (1978), doi:10.1214/aos/1176344136.
Zhang, Siegmund, Biometrics 63, 22 (2007), doi:10.1111/j.1541-0420.2006.00662.x: the criterion with changes at unknown
places.
"""

from __future__ import annotations

from enum import IntEnum
from typing import TYPE_CHECKING, Final, NamedTuple

import cv2
import numpy as np

from napari_elsplus.processing.compiled import lean_kernel, resolved_once
from napari_elsplus.processing.tracking.motion.rolling_shutter import Warp
from napari_elsplus.processing.tracking.registration import lucas_kanade
from napari_elsplus.processing.tracking.registration.lucas_kanade import TONE, UNKNOWNS
from napari_elsplus.processing.tracking.registration.odds import CORRELATED_PX, in_pixels_of
from napari_elsplus.processing.tracking.registration.row_sums import I1

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.front_end.sampling import FramePair
    from napari_elsplus.processing.tracking.motion.rolling_shutter import Velocity

    Matrix = NDArray[np.float64]

_SCORED: Final = lucas_kanade.Iteration(1, 1, 0.0, False)
"""How a rotation is estimated at half resolution: one step."""
_TONE: Final = lucas_kanade.Iteration(4, 1, 0.0, False)
"""How gain and offset are estimated before, on which the noise depends: by regression."""
_STRETCH: Final = UNKNOWNS + 1
_LARGE_STRETCH: Final = 0.1
"""Standard deviation of a stretch of the columns beforehand; chosen: far above any; one fibre has a solution."""
_MARGIN: Final = 2.0
"""How many times the criterion's penalty must be saved: it is tested again and again in a long recording."""
_REMEMBERED: Final = 64
_ONSET: Final = 2.0
"""How many parameters, with the registrations as values, an unknown beginning or end is worth (Zhang & Siegmund)."""
_SCATTER: Final = 2.0
_PRIOR_LINKS: Final = 4
"""Variance of controls, in units of what is stated, and how many registrations that is worth at first."""
_MOST_ALIKE: Final = 0.95
_SUSPICIOUS_SIGMAS: Final = 2.0
"""Rotation over its standard deviation from which it is looked into; chosen: turned frames that are hardly alike have
2.7 and more."""


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
        (5,): change of a, b, s, d that follows from the rotation, and that of rows per column, which is the rotation in
        radians.
    sigma : float
        Standard deviation of the rotation, radians.
    values : float
        Independent values that were compared.
    control : float
        Stretch of the columns, estimated beside the rotation, over its standard deviation.
    """

    step: Matrix
    sigma: float
    values: float
    control: float = 0.0

    @property
    def may_turn(self) -> bool:
        """Return True if a rotation is not improbable: it is larger than chance alone usually makes it."""
        return bool(abs(self.step[-1]) > _SUSPICIOUS_SIGMAS * self.sigma)


def turned_by(angle: float) -> Matrix:
    """Return the matrix that turns (row, col) by an angle in radians, from rows towards columns."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])


def upright(
    image: NDArray[np.float32], out: NDArray[np.float32], centre: tuple[float, float], matrix: Matrix,
    shift: tuple[float, float] | Matrix = (0.0, 0.0),
) -> NDArray[np.float32]:  # fmt: skip
    """Move every point of an image to `matrix` times where it was, about the bundle's centre; beyond it lies zero.

    Parameters
    ----------
    image, out : numpy.ndarray
        (n, n) float32; `out` is filled, by bilinear interpolation, and returned.
    centre : tuple of float
        Row and column of the bundle's centre.
    matrix : numpy.ndarray
        (2, 2), of (row, col).
    shift : tuple or numpy.ndarray of float
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


def turned_while_read(rate: float, warp: Warp, turn: float, diameter: float) -> Matrix:
    """Return what a steady rotation while frames are read adds to the coordinates of the earlier one, (2, 3).

    A frame read at a turn of w a row displaces (y, x) by w y (-x, y). Between two that are shifted this is affine;
    between two of different angles its mean over the disc is turned besides.

    Parameters
    ----------
    rate : float
        Radians per row of the grid.
    warp : Warp
        From the earlier to the later frame, of which the shift is used.
    turn : float
        Angle of the later frame less that of the earlier one, radians.
    diameter : float
        Of the disc, pixels.

    Returns
    -------
    numpy.ndarray
        Matrix of (row, col, 1).
    """
    y, x = -warp.b, -warp.d
    mean = (diameter / 4) ** 2
    down, across = mean * np.sin(turn), mean * (np.cos(turn) - 1)
    return rate * np.array([[-x, -y, x * y + down], [2 * y, 0.0, across - y * y]])


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


@lean_kernel
def score_rotation(
    pair: FramePair, column: float, warp: Warp, stiffness: float, turn: tuple[float, float],
    work: lucas_kanade.Workspace,
) -> tuple[float, ...]:  # fmt: skip
    """Estimate what a rotation would add to a warp; return the numbers of a :class:`Remainder`.

    All are 0 where the frames do not overlap or show nothing.

    Parameters
    ----------
    pair : FramePair
        Frames at half resolution.
    column : float
        Column of the bundle's centre in them.
    warp : Warp
        In pixels of full resolution.
    stiffness : float
        Information on a and s that is there beforehand.
    turn : tuple of float
        Rotation that is expected, radians, and its standard deviation.
    work : Workspace
        For frames of this size or larger.
    """
    normal, right, tone = work.normal, work.right, work.tone
    nothing = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    there = in_pixels_of(2.0, warp)
    tone[0], tone[1] = 1.0, 0.0
    count, template_sum, _, both, _ = lucas_kanade.accumulate(pair, _TONE, there, work, None)
    tone[0] = both / template_sum
    tone[1] = (work.moments[0, I1] - tone[0] * normal[1, 0]) / count
    count, template_sum, image_sum, _, noise = lucas_kanade.accumulate(pair, _SCORED, there, work, column)
    noise *= CORRELATED_PX / 4
    if not (noise > 0 and template_sum > 0 and image_sum > 0):
        return nothing
    lucas_kanade.complete(normal, right, np.sqrt(image_sum / template_sum))
    of_prior = noise / turn[1] ** 2
    normal[TONE, TONE] += stiffness * noise
    normal[TONE + 2, TONE + 2] += stiffness * noise
    normal[UNKNOWNS, UNKNOWNS] += of_prior
    right[UNKNOWNS] += turn[0] * of_prior
    normal[_STRETCH, _STRETCH] += noise / _LARGE_STRETCH**2
    if not lucas_kanade.solve(normal, right, TONE, work.schur):
        return nothing
    control = right[_STRETCH] * np.sqrt(normal[_STRETCH, _STRETCH] / noise)
    right[UNKNOWNS] += normal[UNKNOWNS, _STRETCH] / normal[UNKNOWNS, UNKNOWNS] * right[_STRETCH]  # as without a stretch
    sigma, values = np.sqrt(noise / normal[UNKNOWNS, UNKNOWNS]), count / (CORRELATED_PX / 4)
    for i in range(UNKNOWNS - 1, -1, -1):  # by how much the others change with it: each was registered finely without
        right[i] = 0.0
        for k in range(i + 1, UNKNOWNS + 1):
            right[i] -= normal[i, k] * right[k] / normal[i, i]
    return right[2], 2 * right[3], right[4], 2 * right[5], right[UNKNOWNS], sigma, values, control


def selected_model(found: Sequence[Remainder]) -> MotionModel:
    """Return the model that score tests, `found` in their order, select together.

    A probe may rotate for a while.
    """
    if not found:
        return MotionModel.TRANSLATION
    tests = np.array([(one.step[-1], one.sigma, one.values, one.control) for one in found]).T.copy()
    return MotionModel.RIGID if largest_saving(tests, True) > _MARGIN else MotionModel.TRANSLATION


@lean_kernel
def largest_saving(tests: NDArray[np.float64], ended: bool) -> float:
    """Return what a rotation saves at most of the sum of squares, in units of the criterion's penalty for it.

    Between its beginning and its end, which are sought, registrations have its weighted mean in common; others turn by
    nothing. By as much as the controls exceed their noise, and from one to the next alike, the mean may err as well.
    Weights are inverse variances, so that the few frames with much in view count.

    Parameters
    ----------
    tests : numpy.ndarray
        (4, m) float64: rotation by each score test, its standard deviation, the independent values compared, and the
        control over its own.
    ended : bool
        The rotation may have ended before the last of them.
    """
    turns, sigmas, values, controls = tests[0], tests[1], tests[2], tests[3]
    count, compared, total, squares, products, before = len(turns), 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(count):
        score = controls[k] / sigmas[k]
        total += 1 / (sigmas[k] * sigmas[k])
        squares += score * score
        products += score * before
        compared += values[k]
        before = score
    at_first = _PRIOR_LINKS * total / count
    scatter = (squares + _SCATTER * at_first) / (total + at_first)
    alike = min(max(products / (total * scatter), 0.0), _MOST_ALIKE)
    of_rotation, of_onset = np.log(compared), _ONSET * np.log(count)
    largest = 0.0
    for end in range(1 if ended else count, count + 1):
        weights, scores = 0.0, 0.0
        for first in range(end - 1, -1, -1):
            weight = 1 / (sigmas[first] * sigmas[first])
            weights += weight
            scores += weight * turns[first]
            penalty = of_rotation
            if first > 0:
                penalty += of_onset
            if end < count:
                penalty += of_onset
            largest = max(largest, scores * scores / (weights * penalty))
    return float(largest * (1 - alike) / (scatter * (1 + alike)))


_largest_saving = resolved_once(largest_saving)


class ModelSelection:
    """Sequential selection of the motion model from the score tests of registrations.

    Parameters
    ----------
    model : MotionModel
        From the beginning.

    Attributes
    ----------
    model : MotionModel
        Model of the motion from now on.

    Examples
    --------
    >>> selection = ModelSelection()
    >>> selection.weigh(Remainder(np.zeros(5), 3e-4, 1500.0)).name
    'TRANSLATION'
    >>> turned = Remainder(np.array([0, 0, 0, 0, 0.01]), 3e-4, 1500.0)
    >>> selection.weigh(turned).name
    'RIGID'
    """

    def __init__(self, model: MotionModel = MotionModel.TRANSLATION) -> None:
        self.model = model
        self._found = np.zeros((4, _REMEMBERED))
        self._first = _REMEMBERED - 1

    def weigh(self, found: Remainder, *, keep: bool = True) -> MotionModel:
        """Test a registration together with those before; return the model selected. It is stored if it is to be kept.

        Parameters
        ----------
        found : Remainder
            Score test of a registration.
        keep : bool
            Add its evidence to that of the earlier ones.
        """
        tests = self._found
        tests[:, -1] = found.step[-1], found.sigma, found.values, found.control
        if _largest_saving(tests[:, self._first :], False) > _MARGIN:
            self.model = MotionModel.RIGID
        if keep:
            tests[:, :-1] = tests[:, 1:]
            self._first = max(self._first - 1, 0)
        return self.model
