"""Row error of a scan: by how much the line misses the slit while each row is exposed.

The drive is shifted by constant volts, which move the line by the same number of rows at all times. A row is brightest
in the scan whose shift cancels its error. Shifts of the drive in time would not do: they change the flyback, too.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy import ndimage

from napari_elsplus.processing.analysis.uncertainty import robust_sigma

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import BundleSection
    from napari_elsplus.processing.images.sectioning import Frames

    Floats = NDArray[np.float64]

MIN_DEPTH_ROWS: Final = 4.5
"""Of a row below the rim; chosen: nearer to it, a line that is half its width away is already off the bundle."""
MIDDLE_SHARE: Final = 0.5
"""Part of a chord whose light is averaged; chosen: a line at a quarter of the depth still lights all of it."""
PEAK_ROWS: Final = 3.0
"""Standard deviation of the weights about a row's peak; chosen: a line with its slit is 2 to 6 rows wide."""
RIM_ROWS: Final = 3.0
"""Beyond the lit rows, farther than which a line is off the bundle; derived: their distance from the rim, less 1.5."""
MIN_SIGMAS: Final = 6.0
"""Height of a row's peak in standard deviations of its noise; chosen: noise alone exceeds it in no row."""
MAX_STRAY_ROWS: Final = 4.0
"""From the running median, beyond which a row's peak is rejected; chosen, above the change over half its width."""
MEDIAN_ROWS: Final = 31
"""Rows of the running median; chosen: several cores."""
JOINT_ROWS: Final = 20
"""Rows of both views by which their errors are joined; chosen: several cores."""
SMOOTHING_ROWS: Final = 4.0
"""Standard deviation of the smoothing along rows; chosen: wider than a core, narrower than the galvo's response."""


@dataclass(frozen=True, slots=True)
class RowErrors:
    """Row errors of a scan.

    Parameters
    ----------
    rows : numpy.ndarray
        Row of the line minus row of the slit for each row of the frame, smoothed along rows, shape (rows,); NaN where
        no shift met the line.
    wanted : numpy.ndarray
        True in the rows in which the line must be on the slit, shape (rows,).
    """

    rows: Floats
    wanted: NDArray[np.bool_]

    @property
    def seen_share(self) -> float:
        """Share of the wanted rows whose error is known."""
        return float(np.isfinite(self.rows[self.wanted]).mean())

    @property
    def largest_rows(self) -> float:
        """Largest known error of a wanted row."""
        return float(np.nanmax(np.abs(self.rows[self.wanted]), initial=0.0))

    @property
    def cost(self) -> float:
        """Largest error of a wanted row, at most 20 rows, or 20 for each unknown one: by which scans are compared."""
        errors = np.nan_to_num(np.abs(self.rows[self.wanted]), nan=20.0)
        return float(np.minimum(errors, 20.0).max() + 20.0 * np.count_nonzero(errors >= 20.0))

    def count_off(self, limit_rows: float) -> int:
        """Return the number of wanted rows whose error exceeds a limit in rows, or is unknown."""
        return int(np.count_nonzero(~(np.abs(self.rows[self.wanted]) <= limit_rows)))


class RowProfile:
    """Mean grey level of the rows of both views, along the middle of their chords.

    Parameters
    ----------
    bundle : BundleSection
        Centres and diameter of both views.
    shape : tuple of int
        Rows and columns of a frame.
    bow_rows : float
        Rows by which the line's ends at the bundle's rim lie below its middle.

    Attributes
    ----------
    offset_rows : float
        Row of the residual view minus that of the confocal view.
    lit : numpy.ndarray
        True in the rows of either view that are far enough from the rim, (2, rows).
    bowed_rows : float
        Rows by which the middle of a bowed line, at which the galvo map holds, lies below
        its mean over the middles of the chords.
    """

    def __init__(self, bundle: BundleSection, shape: tuple[int, int], bow_rows: float = 0.0) -> None:
        # The mean square distance from the middle is a quarter of the squared radius, that of the middles their part.
        self.bowed_rows = -bow_rows * MIDDLE_SHARE**2 / 4
        self.offset_rows = bundle.offset_rows
        self._views = [_chords(centre, diameter_px, shape) for centre, diameter_px in bundle.discs]
        self.lit = np.stack([last > first for first, last in self._views])

    def __call__(self, frames: Frames) -> Floats:
        """Return the mean profile of raw frames (rows, cols): confocal and residual view, shape (2, rows)."""
        profile = np.zeros(self.lit.shape)
        for number in range(len(frames)):
            frame = frames[number]
            sums: NDArray[np.uint32 | np.float64] = np.cumsum(
                frame, axis=1, dtype=np.uint32 if frame.dtype.kind == "u" else np.float64
            )
            rows = np.arange(len(sums))
            for view, (first, last) in enumerate(self._views):
                profile[view] += (sums[rows, last] - sums[rows, first]) / np.maximum(last - first, 1)
        return profile / len(frames)


def _chords(
    centre: tuple[float, float], diameter_px: float, shape: tuple[int, int]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return first and last column of the middle of a disc's chord in each row; equal near the rim."""
    away = np.abs(np.arange(shape[0]) - centre[0])
    half = np.sqrt(np.maximum((diameter_px / 2) ** 2 - away**2, 0.0))
    reach = np.where(away <= diameter_px / 2 - MIN_DEPTH_ROWS, MIDDLE_SHARE * half, 0.0)
    first, last = (np.clip(np.rint(centre[1] + side * reach), 0, shape[1] - 1).astype(np.intp) for side in (-1, 1))
    return first, last


def find_row_errors(shifts_rows: Floats, profiles: Floats, lit: NDArray[np.bool_]) -> Floats:
    """Find the shift at which each row of a view is brightest, and return it with the opposite sign.

    Parameters
    ----------
    shifts_rows : numpy.ndarray
        Shifts of the drive in rows, equally spaced, shape (n,).
    profiles : numpy.ndarray
        Row profiles of the view at each, shape (n, rows).
    lit : numpy.ndarray
        True in the rows of the view, those next to its rim left out, shape (rows,).

    Returns
    -------
    numpy.ndarray
        Row of the line, as it is in this view, minus row of the slit, shape (rows,); NaN where no shift met it.
    """
    step, rows = shifts_rows[1] - shifts_rows[0], np.arange(len(lit))
    first, last = (int(value) for value in np.flatnonzero(lit)[[0, -1]])
    smooth = ndimage.gaussian_filter1d(profiles, PEAK_ROWS / step, axis=0, mode="nearest")
    rough = profiles - ndimage.gaussian_filter1d(profiles, 1.0, axis=0, mode="nearest")
    noise = robust_sigma(rough, axis=0) + 1e-9
    best = np.argmax(smooth, axis=0)
    clear = smooth[best, rows] - smooth.min(axis=0) > MIN_SIGMAS * noise
    peak = shifts_rows[best]
    for _ in range(3):
        away = shifts_rows[:, None] - peak
        inside = (rows + away >= first - RIM_ROWS) & (rows + away <= last + RIM_ROWS)
        weights = np.exp(-0.5 * np.square(away / PEAK_ROWS)) * inside
        slope, bend = _parabola(away, profiles, weights)
        move = np.where(bend < 0, -0.5 * slope / np.minimum(bend, -1e-12), np.nan)
        peak = peak + np.clip(move, -PEAK_ROWS, PEAK_ROWS)
    within = (peak > shifts_rows[0] + step) & (peak < shifts_rows[-1] - step)
    return np.asarray(np.where(lit & clear & within, -peak, np.nan))


def _parabola(x: Floats, y: Floats, weights: Floats) -> tuple[Floats, Floats]:
    """Return slope and bend of the parabolas through columns of data, shape (n, columns), by weighted least squares."""
    moments = [(weights * x**power).sum(axis=0) for power in range(5)]
    sums = [(weights * y * x**power).sum(axis=0) for power in range(3)]
    normal = np.stack([np.stack(moments[power : power + 3], axis=-1) for power in range(3)], axis=-2)
    normal = normal + 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    found = np.linalg.solve(normal + 1e-12 * np.eye(3), np.stack(sums, axis=-1)[..., None])[..., 0]
    return found[:, 1], found[:, 2]


def join_views(confocal: Floats, residual: Floats, wanted: NDArray[np.bool_]) -> RowErrors:
    """Return the row errors of the confocal view, completed by those of the residual view, smoothed along rows.

    The residual view reveals rows beyond the confocal disc, but with the line elsewhere on the galvo's curve: its
    errors are raised to meet those of the confocal view in the rows that both contain next to them.

    Parameters
    ----------
    confocal, residual : numpy.ndarray
        Row errors found in each view, those of the residual view without the offset, shape (rows,); NaN where unknown.
    wanted : numpy.ndarray
        True in the rows in which the line must be on the slit, shape (rows,).
    """
    both = np.flatnonzero(np.isfinite(confocal) & np.isfinite(residual))
    errors = confocal
    if len(both) >= JOINT_ROWS:
        missing = np.flatnonzero(np.isfinite(residual) & ~np.isfinite(confocal))
        nearest = np.clip(np.searchsorted(both, missing), JOINT_ROWS // 2, len(both) - JOINT_ROWS // 2)
        differences = ndimage.median_filter((confocal - residual)[both], JOINT_ROWS, mode="nearest")
        errors = confocal.copy()
        errors[missing] = residual[missing] + differences[nearest - 1]
    return RowErrors(np.where(wanted, _smoothed(_without_strays(errors)), np.nan), wanted)


def _without_strays(errors: Floats) -> Floats:
    """Return the errors, NaN where they are far from those of the rows around."""
    found = np.flatnonzero(np.isfinite(errors))
    if len(found) < MEDIAN_ROWS:
        return np.full_like(errors, np.nan)
    around = ndimage.median_filter(errors[found], MEDIAN_ROWS, mode="nearest")
    errors = errors.copy()
    errors[found[np.abs(errors[found] - around) > MAX_STRAY_ROWS]] = np.nan
    return errors


def _smoothed(errors: Floats) -> Floats:
    """Return the local straight line through the known rows around each row; NaN far from any."""
    known = np.isfinite(errors)
    away = np.arange(-3 * SMOOTHING_ROWS, 3 * SMOOTHING_ROWS + 1)
    bell = np.exp(-0.5 * np.square(away / SMOOTHING_ROWS))
    count, first, second = (
        np.convolve(known.astype(np.float64), (bell * (-away) ** power), mode="same") for power in range(3)
    )
    filled = np.where(known, errors, 0.0)
    level, tilt = (np.convolve(filled, bell * (-away) ** power, mode="same") for power in range(2))
    spread = count * second - first**2
    line = (second * level - first * tilt) / np.where(spread > 0, spread, np.inf)
    return np.asarray(np.where(count > 0.25 * bell.sum(), line, np.nan))
