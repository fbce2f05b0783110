"""Row noise of the camera, estimated from the dark pixels of each row and taken off the frame.

Each row of a rolling shutter is read with an offset of its own, common to all of its pixels. Where it fluctuates, a row
beside the laser line may be brighter than the line's rim, and a dark row longer than any line.
"""

from __future__ import annotations

from functools import cached_property
from math import ceil, floor
from typing import TYPE_CHECKING, Any, Final

import cv2
import numpy as np
from scipy import ndimage

from napari_elsplus.instrument.frame_region import require_frame_shape

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.processing.images.modes import Frames

    Image = NDArray[np.float32]
    Mask = NDArray[np.uint8]

MIN_DARK_PIXELS: Final = 8
"""Dark pixels of a row below which there is no reference; chosen: fewer are noisier than what they correct."""
MIN_NOISE_SHARE: Final = 0.5
"""Share of the reference's variance that is row noise, below which frames are left alone; chosen: the reference would
add as much noise as it removes."""
RIM_MARGIN_PX: Final = 4.0
"""Around the bundle views, in pixels; chosen: a core and the rim's blur. Where the views fill the frame, as at 120 Hz,
twice as much leaves no dark pixel beside their middles."""
MIN_ROWS: Final = 16
"""Rows with a reference below which there is none; chosen: as few as a view of the bundle may have."""
SMOOTH_PX: Final = 5
"""Columns over which the light is averaged before columns are compared; chosen: a core and its gap."""
SAMPLED_ROWS, SAMPLED_COLUMNS = 200, 128
"""Of a frame, from which row noise is detected; chosen: it then stands out from a tenth of a grey level on."""
AVERAGED_ROWS: Final = 4
"""Rows over which the light is averaged before columns are compared; chosen: as wide as a laser line."""
DARKEST: Final = 0.02
"""Share of a row's columns that are darker than its darkness; chosen: the few least are chance."""
DARK_LIGHT: Final = 0.1
"""Part of the brightest columns' light up to which a column counts as dark; chosen."""


def dark_pixels(shape: tuple[int, ...], discs: Iterable[tuple[tuple[float, float], float]]) -> Mask:
    """Return 1 in the pixels outside of the discs and of `RIM_MARGIN_PX` around them, 0 inside, (rows, cols) uint8.

    Parameters
    ----------
    shape : tuple of int
        Rows and columns of the frame.
    discs : iterable of tuple
        Centre (row, col) and diameter in pixels of each.
    """
    dark = np.ones(shape, np.uint8)
    for centre, diameter_px in discs:
        radius = diameter_px / 2 + RIM_MARGIN_PX
        rows = np.arange(max(ceil(centre[0] - radius), 0), min(floor(centre[0] + radius) + 1, shape[0]))
        half = np.sqrt(radius**2 - np.square(rows - centre[0]))
        ends = np.stack((np.ceil(centre[1] - half), np.floor(centre[1] + half) + 1), axis=1)
        for row, (first, stop) in zip(rows.tolist(), np.clip(ends, 0, shape[1]).astype(int).tolist(), strict=True):
            dark[row, first:stop] = 0
    return dark


def dark_columns(frame: Image) -> Mask:
    """Return 1 in the columns of a frame (rows, cols) that no light reaches, 0 elsewhere, as wide as the frame."""
    small = cv2.resize(frame, (frame.shape[1], max(1, frame.shape[0] // AVERAGED_ROWS)), interpolation=cv2.INTER_AREA)
    smooth = cv2.blur(small, (SMOOTH_PX, 1))
    # Row noise, which all columns share, cancels in the difference to the darkest columns.
    ordered = np.sort(smooth[:, ::SMOOTH_PX], axis=1)
    darkest = ordered[:, [round(DARKEST * (ordered.shape[1] - 1))]]
    light = np.asarray((smooth - darkest).max(axis=0), np.float64)
    low, high = np.percentile(light, (1, 90))
    lit = ndimage.binary_dilation(light > low + DARK_LIGHT * (high - low), iterations=SMOOTH_PX)
    return np.broadcast_to((~lit).astype(np.uint8), frame.shape)


TESTED_FRAMES: Final = 4
"""Frames of a series that are tested for row noise; chosen: its amplitude is the camera's, and does not change."""
OPENED_FRAMES: Final = 2
"""First frames of a recording that are tested for row noise; chosen: those that are read to open it anyway."""
STRAY_LIGHT_ROWS: Final = 61
"""Rows of the running median that images keep of their dark pixels; chosen: stray light varies over more."""


def reference_of_rows(calibration: Calibration, frame_shape: tuple[int, ...], test_interval: int = 1) -> RowReference:
    """Return the reference for row noise of the frames of a calibrated region.

    Parameters
    ----------
    calibration : Calibration
        With its bundle section.
    frame_shape : tuple of int
        Rows and columns of the raw frames.
    test_interval : int
        As of :class:`RowReference`.

    Raises
    ------
    CalibrationError
        If the calibration was measured on frames of another size.
    """
    require_frame_shape(calibration, frame_shape)
    dark = dark_pixels(frame_shape, calibration.measured_bundle.discs)
    return RowReference(dark, calibration.background, STRAY_LIGHT_ROWS, test_interval)


def shows_row_noise(frames: Frames, calibration: Calibration) -> bool:
    """Return True if one of the first frames of a recording shows row noise.

    Parameters
    ----------
    frames : sequence of numpy.ndarray
        Raw frames (rows, cols) of one setting of the camera.
    calibration : Calibration
        Of the rig that recorded them; with its bundle section.
    """
    reference = reference_of_rows(calibration, frames[0].shape)
    return any(reference.shows_noise(frames[number]) for number in range(min(OPENED_FRAMES, len(frames))))


class RowReference:
    """The row noise of frames of one region, as their dark pixels show it.

    Parameters
    ----------
    dark : numpy.ndarray
        1 in dark pixels, 0 elsewhere, (rows, cols) uint8.
    background : numpy.ndarray, optional
        Mean frame of the dark tube, (rows, cols), which will be taken off: what it contains is left in the frames.
    smooth_rows : int, optional
        Width of a running median of the rows that is left in the frames, as stray light; by default all but the median.
    test_interval : int
        Frames from one test for row noise to the next; those between are taken to have it as the last tested one.

    Notes
    -----
    Even and odd columns are averaged apart. Their covariance over the rows is the variance of the row noise, whatever
    the noise of the pixels; over the variance of their mean it is the factor by which the reference counts (Wiener).
    A part of the rows and columns decides first, so that frames without row noise take hardly any time.

    Examples
    --------
    >>> random = np.random.default_rng(0)
    >>> noise = random.normal(0, 2, (200, 1))
    >>> frame = 4 + noise + random.normal(0, 0.5, (200, 300))
    >>> left = RowReference(np.ones(frame.shape, np.uint8)).without_row_noise(frame)
    >>> bool(left.mean(axis=1).std() < 0.1)
    True
    """

    def __init__(
        self,
        dark: Mask,
        background: Image | None = None,
        smooth_rows: int | None = None,
        test_interval: int = 1,
    ) -> None:
        self._test_interval, self._until_test, self._noisy = test_interval, 0, False
        self._dark, self._background, self._smooth_rows = dark, background, smooth_rows
        self._every = max(1, dark.shape[0] // SAMPLED_ROWS)
        some = None if background is None else background[:: self._every]
        smooth = None if smooth_rows is None else max(3, smooth_rows // self._every)
        self._some = _Columns(dark[:: self._every], some, max(1, dark.shape[1] // SAMPLED_COLUMNS), smooth)

    @cached_property
    def _all(self) -> _Columns:
        return _Columns(self._dark, self._background, 1, self._smooth_rows)

    def shows_noise(self, frame: NDArray[np.generic]) -> bool:
        """Return True if a part of the rows and columns of a frame (rows, cols) shows row noise."""
        return self._some.row_noise(frame[:: self._every]) is not None

    def some_show_noise(self, frames: Frames) -> bool:
        """Return True if one of `TESTED_FRAMES` frames (rows, cols) of a series shows row noise."""
        numbers = np.unique(np.linspace(0, len(frames) - 1, TESTED_FRAMES).round().astype(int)).tolist()
        return any(self.shows_noise(frames[number]) for number in numbers)

    def retest(self) -> None:
        """Test the next frame, however many frames ago the last test was."""
        self._until_test = 0

    def without_row_noise(self, frame: NDArray[np.generic]) -> NDArray[np.generic]:
        """Return a frame (rows, cols) less its row noise, float32; the frame itself where it has none."""
        if not self._until_test:
            self._noisy, self._until_test = self.shows_noise(frame), self._test_interval
        self._until_test -= 1
        if not self._noisy:
            return frame
        noise = self._all.row_noise(frame)
        return frame if noise is None else np.subtract(frame, noise[:, None], dtype=np.float32)


class _Columns:
    """Even and odd ones of every few columns, and their dark pixels."""

    def __init__(self, dark: Mask, background: Image | None, step: int, smooth_rows: int | None) -> None:
        self._smooth_rows = smooth_rows
        self._parts = slice(0, None, 2 * step), slice(1, None, 2 * step)
        self._dark = [np.ascontiguousarray(dark[:, part], np.float32) for part in self._parts]
        counts = [mask.sum(axis=1) for mask in self._dark]
        self._counts = [np.maximum(count, 1) for count in counts]
        self._known = np.minimum(*counts) >= MIN_DARK_PIXELS / 2
        self._background = [0.0, 0.0] if background is None else self._means(background)

    def _means(self, frame: NDArray[np.generic]) -> list[Any]:
        """Return the mean of the dark pixels of each row, in the even and in the odd columns."""
        parts = (np.ascontiguousarray(frame[:, part], np.float32) for part in self._parts)
        return [
            np.einsum("ij,ij->i", part, mask) / count
            for part, mask, count in zip(parts, self._dark, self._counts, strict=True)
        ]

    def _level(self, means: NDArray[np.float32]) -> Any:
        """Return what of the means of rows is no noise."""
        if self._smooth_rows is None:
            return np.median(means[self._known])
        level = np.zeros_like(means)
        level[self._known] = ndimage.median_filter(means[self._known], self._smooth_rows, mode="nearest")
        return level

    def row_noise(self, frame: NDArray[np.generic]) -> NDArray[np.float32] | None:
        """Return the row noise of a frame, grey levels (rows,); None where it does not stand out of the pixels'."""
        if np.count_nonzero(self._known) < MIN_ROWS:
            return None
        halves = (mean - of_dark for mean, of_dark in zip(self._means(frame), self._background, strict=True))
        even, odd = (np.asarray(half - self._level(half), np.float64) for half in halves)
        mean = (even + odd) / 2
        covariance = float(np.mean((even * odd)[self._known]))
        variance = float(np.mean(np.square(mean[self._known])))
        trust = covariance / variance if variance > 0 else 0.0
        if trust < MIN_NOISE_SHARE:
            return None
        return np.where(self._known, trust * mean, 0.0).astype(np.float32)
