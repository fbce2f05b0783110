"""Power of the laser that differs from row to row, estimated from the light that both views share and taken off images.

A row of the camera is exposed in both views at the same time, while they show parts of the specimen that lie apart by
the slit offset: what their light has in common in a row is the laser's. The residual view is out of focus, so that its
light varies slowly over the rows, and shows the power best.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from scipy import ndimage

from napari_elsplus.errors import CalibrationError, InputError
from napari_elsplus.processing.images.sectioning import Mode, Sectioner, disc

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import Calibration

    Floats = NDArray[np.float64]
    Image = NDArray[np.float32]

SMOOTH_ROWS: Final = 15.0
"""Standard deviation of the Gaussian by which the specimen's light is taken off, rows; measured on hazy nuclei at
240 Hz: 5 % of power noise are then found to 1.3 %, with 40 rows to 3 %."""
MIN_SHARED: Final = 0.75
"""Correlation of the views' rows above which they show the power; measured: under 5 % of power noise 0.82 and 0.93 on
hazy nuclei (240 and 120 Hz), without it 0.13 and 0.28; at most 0.66 on nuclei without haze."""
MAX_ALIGNED: Final = 0.6
"""The same with the specimen aligned, up to which rows of one brightness are no structure of the specimen; chosen."""
MIN_POWER: Final = 0.01
"""Relative standard deviation of the shared light below which images are left alone; chosen: estimates err by it."""
MIN_CHORD: Final = 0.5
"""Part of the diameter that a row, and the line beside it, must cover; chosen: towards the rim the residual's light
falls off."""


class RowPower:
    """Correction of images for power that differs from row to row.

    Parameters
    ----------
    sectioner : Sectioner
        Which makes the images.
    calibration : Calibration
        Its calibration, with a flat field, by which the pattern of the cores is divided.

    Raises
    ------
    CalibrationError
        If there is no flat field.
    """

    def __init__(self, sectioner: Sectioner, calibration: Calibration) -> None:
        if calibration.flat is None:
            raise CalibrationError("the calibration has no flat field", "measure it with `calibrate --flat`")
        self._sectioner = sectioner
        lit = disc(sectioner.side, 0.95 * sectioner.diameter_px) & sectioner.subtracted
        self._weights = np.where(lit, calibration.flat, 0).astype(np.float32)
        self._expected = np.einsum("ij,ij->i", self._weights, self._weights)
        self._offset_rows = calibration.measured_bundle.offset_rows
        half = np.sqrt(1 - MIN_CHORD**2) * sectioner.diameter_px / 2
        from_middle = np.arange(sectioner.side) - sectioner.centre[0]
        self._rows = np.maximum(np.abs(from_middle), np.abs(from_middle + self._offset_rows)) < half

    def image(self, raw: NDArray[np.generic], mode: Mode) -> Image:
        """Return the image of a mode of a raw frame (rows, cols), its rows divided by the power where it is shown.

        Raises
        ------
        InputError
            For ELSA, whose views are those of two frames.
        """
        if mode is Mode.ELSA:
            raise InputError("the power of rows is that of one frame, and ELSA is made of two", "choose els")
        ls, residual = np.empty((2, self._sectioner.side, self._sectioner.side), np.float32)
        self._sectioner.fill(raw, raw, ls=ls, residual=residual)
        powers = self.powers(ls, residual)
        if powers is not None:
            ls /= powers[0][:, None]
            residual /= powers[1][:, None]
        return {Mode.LS: ls, Mode.RESIDUAL: residual}.get(mode, ls - residual)

    def powers(self, ls: Image, residual: Image) -> tuple[Floats, Floats] | None:
        """Return the relative power in the rows of the two images, (n,) each; None where they do not show it.

        Parameters
        ----------
        ls, residual : numpy.ndarray
            (n, n) images of one frame.
        """
        confocal, behind = (self._varying(image) for image in (ls, residual))
        if confocal is None or behind is None:
            return None
        reach = int(np.ceil(abs(self._offset_rows)))
        row, rows = np.arange(-reach, len(ls) + reach, dtype=np.float64), np.flatnonzero(self._rows)
        # The camera's rows, numbered as in LS: the residual view shows there what lies the offset higher.
        views = np.stack([_at(row, rows, confocal), _at(row - self._offset_rows, rows, behind)])
        both = np.isfinite(views).all(axis=0)
        covariance = views[:, both] @ views[:, both].T / np.count_nonzero(both)
        shared, variances = float(covariance[0, 1]), np.diag(covariance)
        aligned = float(np.corrcoef(confocal, behind)[0, 1])
        if shared < max(MIN_SHARED * float(np.sqrt(variances.prod())), MIN_POWER**2) or aligned > MAX_ALIGNED:
            return None
        # Each view counts by what it does not share with the other (Wiener).
        weights = np.where(np.isfinite(views), 1 / np.maximum(variances - shared, MIN_POWER**2)[:, None], 0)
        power = np.exp((weights * np.nan_to_num(views)).sum(axis=0) / (1 / shared + weights.sum(axis=0)))
        of_image = np.arange(len(ls))
        return np.interp(of_image, row, power), np.interp(of_image + self._offset_rows, row, power)

    def _varying(self, image: Image) -> Floats | None:
        """Return the logarithm of the light of the rows that count, less its slow part; None where a row is dark."""
        light = np.einsum("ij,ij->i", self._weights, np.nan_to_num(image))[self._rows] / self._expected[self._rows]
        if not light.min(initial=np.inf) > 0:
            return None
        level = np.log(light.astype(np.float64))
        return np.asarray(level - ndimage.gaussian_filter1d(level, SMOOTH_ROWS, mode="nearest"), np.float64)


def _at(row: Floats, rows: NDArray[np.intp], values: Floats) -> Floats:
    """Return values that are known in some rows at others, linearly interpolated; NaN beyond."""
    return np.interp(row, rows, values, left=np.nan, right=np.nan)
