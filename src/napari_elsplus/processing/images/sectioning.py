"""Sectioning of raw frames into LS, residual, ELS+ and ELSA images: the paper's Image Processing, in signed numbers.

The background (a mean frame of the dark tube) is subtracted, the two views are resampled onto one grid, and the
residual is subtracted from the confocal image. Nothing is clipped: a saturating subtraction turns noise into
background.
"""

from __future__ import annotations

from math import ceil
from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.errors import CalibrationError
from napari_elsplus.instrument.frame_region import require_frame_shape
from napari_elsplus.processing.images.distortion import polynomial_terms
from napari_elsplus.processing.images.fused import FusedSections
from napari_elsplus.processing.images.hot_pixels import HotPixels
from napari_elsplus.processing.images.modes import Frames as Frames
from napari_elsplus.processing.images.modes import Mode as Mode
from napari_elsplus.processing.images.resampling import Resampler, affine_positions, within_frame
from napari_elsplus.processing.images.residual_gain import inverse_gain_map
from napari_elsplus.processing.images.row_reference import reference_of_rows

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import BundleSection, Calibration

    View = Callable[[NDArray[np.generic], NDArray[np.float32]], NDArray[np.float32]]
    """Fills an image (n, n) from a raw frame (rows, cols), and returns it."""

LINE_FIELD: Final = 0.96
"""Part of the bundle's diameter in which the residual's line must stand where the frame cuts the views; measured on two
simulated recordings of cut views: between 0.93 and 0.97 correlation and tracking are best."""


def side_px(diameter_px: float) -> int:
    """Return the side of a bundle's square image: `diameter_px` rounded up, and a margin of one pixel on each side."""
    return ceil(diameter_px) + 2


def disc(side: int, diameter_px: float) -> NDArray[np.bool_]:
    """Return the pixels of a square grid within a circle about its middle.

    Parameters
    ----------
    side : int
        Rows and columns of the grid.
    diameter_px : float
        Diameter of the circle, pixels.

    Returns
    -------
    numpy.ndarray
        (side, side), bool.

    Examples
    --------
    >>> int(disc(5, 3.0).sum())
    9
    """
    axis = np.arange(side) - (side - 1) / 2
    inside: NDArray[np.bool_] = axis[:, None] ** 2 + axis**2 <= (diameter_px / 2) ** 2
    return inside


class Sectioner:
    """Sectioning of raw frames under one calibration: resampled views and their differences.

    Results are (n, n) float32 signed grey levels on the confocal view's grid, the bundle's centre at (n - 1) / 2 (or at
    most half a pixel from there, on the camera's grid), zero outside the lit disc. Where the frame's edge cuts one of
    the views, LS is zero beyond it; the residual and the differences are NaN in those pixels of which the frame does
    not contain both views, and in those whose residual's line stood outside of the bundle, as their difference would be
    LS. Buffers are reused from call to call: use one sectioner per thread.

    Parameters
    ----------
    calibration : Calibration
        With its bundle section; its background, if any, is subtracted.
    frame_shape : tuple of int
        Rows and columns of the raw frames.
    on_camera_grid : bool
        Do not resample the confocal view: the grid is the camera's, which takes a third less time.
    row_reference : bool
        Take the camera's row noise off frames whose dark pixels show it.
    row_test_interval : int
        Frames from one test for row noise to the next.

    Attributes
    ----------
    side : int
        n, rows and columns of the images.
    diameter_px : float
        Diameter of the lit disc, pixels.
    centre : tuple of float
        Row and column of the bundle's centre in the images.
    inside : numpy.ndarray
        (n, n), bool: the lit disc.
    seen : numpy.ndarray
        (n, n), bool: pixels that lie within the frame in both views.
    subtracted : numpy.ndarray
        (n, n), bool: pixels whose residual and differences are not NaN.

    Raises
    ------
    CalibrationError
        If the bundle section is absent, or was measured on frames of another shape.
    """

    def __init__(
        self,
        calibration: Calibration,
        frame_shape: tuple[int, int],
        *,
        on_camera_grid: bool = False,
        row_reference: bool = False,
        row_test_interval: int = 1,
    ) -> None:
        bundle = calibration.measured_bundle
        require_frame_shape(calibration, frame_shape)
        _check_possible(bundle, frame_shape)
        self.diameter_px = bundle.diameter_px
        self.side = side_px(bundle.diameter_px)
        self.inside = disc(self.side, bundle.diameter_px + 2)
        middle = (self.side - 1) / 2
        grid_to_confocal = np.eye(3)
        shift = np.subtract(bundle.confocal_centre, middle)
        grid_to_confocal[:2, 2] = np.rint(shift) if on_camera_grid else shift
        row, col = np.subtract(bundle.confocal_centre, grid_to_confocal[:2, 2])
        self.centre = float(row), float(col)
        residual_to_confocal = np.vstack([bundle.residual_to_confocal, (0.0, 0.0, 1.0)])
        grid_to_residual = np.linalg.solve(residual_to_confocal, grid_to_confocal)
        maps = grid_to_confocal[:2], grid_to_residual[:2]
        confocal_seen, residual_seen = (within_frame(each, self.side, frame_shape) for each in maps)
        if not (confocal_seen.any() and residual_seen.any()):
            raise CalibrationError(
                f"a bundle view lies outside of the {frame_shape[0]} x {frame_shape[1]} frame",
                "locate the bundle views again",
            )
        self.seen = confocal_seen & residual_seen
        whole = bool(np.all(self.seen >= self.inside))
        self.subtracted = self.seen if whole else self.seen & _line_within_bundle(calibration, self.side)
        self._beyond_frame = None if whole else ~confocal_seen
        self._hot_pixels = HotPixels(calibration.background)
        self._rows = reference_of_rows(calibration, frame_shape, row_test_interval) if row_reference else None
        background = None if calibration.background is None else self._hot_pixels.mended(calibration.background)
        factors = inverse_gain_map(calibration, self.centre, self.side)
        if not whole:
            unknown = np.where(self.inside & ~self.subtracted, np.float32(np.nan), np.float32(1))
            factors = unknown if factors is None else factors * unknown
        fits = [FusedSections.fits(each, self.side) for each in maps]
        self._views: FusedSections | _Views
        if all(fits) and calibration.distortion is None:
            self._views = FusedSections(*maps, bundle.residual_gain, self.inside, background, frame_shape, factors)
            return
        inside = self.inside.astype(np.float32)
        positions = self._residual_positions(calibration, maps[1])
        brightness = inside / np.float32(bundle.residual_gain) * (1 if factors is None else factors)
        self._views = _Views(
            FusedSections(maps[0], maps[0], 1.0, self.inside, background, frame_shape).ls
            if fits[0]
            else _View(affine_positions(maps[0], self.side), inside, background),
            _View(positions, brightness, background),
        )

    def _residual_positions(
        self, calibration: Calibration, grid_to_residual: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return where the residual view lies in the frame, (2, n, n): affine, with its distortion."""
        positions = affine_positions(grid_to_residual, self.side)
        if calibration.distortion is None:
            return positions
        rows, cols = np.mgrid[: self.side, : self.side].astype(np.float64)
        unit = self.diameter_px / 2
        terms = polynomial_terms((rows - self.centre[0]) / unit, (cols - self.centre[1]) / unit)
        return positions + np.tensordot(calibration.distortion, terms, 1)

    def ls(self, raw: NDArray[np.generic], out: NDArray[np.float32] | None = None) -> NDArray[np.float32]:
        """Return the confocal view of a raw frame.

        Parameters
        ----------
        raw : numpy.ndarray
            (rows, cols) grey levels.
        out : numpy.ndarray, optional
            (n, n) float32, filled and returned.
        """
        return self.section(raw, raw, Mode.LS, out)

    def residual(self, raw: NDArray[np.generic], out: NDArray[np.float32] | None = None) -> NDArray[np.float32]:
        """Return the residual view of a raw frame, aligned and divided by its gain; arguments as in :meth:`ls`."""
        return self.section(raw, raw, Mode.RESIDUAL, out)

    def els(self, raw: NDArray[np.generic], out: NDArray[np.float32] | None = None) -> NDArray[np.float32]:
        """Return ELS+ of a raw frame, exactly ``ls(raw) - residual(raw)``; arguments as in :meth:`ls`."""
        return self.section(raw, raw, Mode.ELS, out)

    def elsa(
        self, raw: NDArray[np.generic], raw_next: NDArray[np.generic], out: NDArray[np.float32] | None = None
    ) -> NDArray[np.float32]:
        """Return sequential ELS: confocal view of `raw` minus residual view of `raw_next`; see :meth:`ls`."""
        return self.section(raw, raw_next, Mode.ELSA, out)

    def fill(
        self,
        raw: NDArray[np.generic],
        raw_residual: NDArray[np.generic],
        *,
        ls: NDArray[np.float32] | None = None,
        residual: NDArray[np.float32] | None = None,
        els: NDArray[np.float32] | None = None,
    ) -> None:
        """Make the images that are given, in one pass.

        Parameters
        ----------
        raw, raw_residual : numpy.ndarray
            (rows, cols) frames of the confocal and of the residual view; one frame twice, except for ELSA.
        ls, residual, els : numpy.ndarray, optional
            (n, n) float32, filled: the two views, and the confocal minus the residual view.
        """
        same = raw_residual is raw
        raw = self._mended(raw)
        raw_residual = raw if same else self._mended(raw_residual)
        self._views(raw, raw_residual, ls, residual, els)
        if ls is not None and self._beyond_frame is not None:
            ls[self._beyond_frame] = 0

    def retest_row_noise(self) -> None:
        """Test the next frame for row noise, however many frames ago the last test was."""
        if self._rows is not None:
            self._rows.retest()

    def _mended(self, raw: NDArray[np.generic]) -> NDArray[np.generic]:
        """Return a raw frame without its hot pixels and row noise; the frame itself if it has none."""
        mended = self._hot_pixels.mended(raw)
        return mended if self._rows is None else self._rows.without_row_noise(mended)

    def section(
        self,
        raw: NDArray[np.generic],
        raw_residual: NDArray[np.generic],
        mode: Mode,
        out: NDArray[np.float32] | None = None,
    ) -> NDArray[np.float32]:
        """Return the image of a mode from the raw frames of its two views.

        Parameters
        ----------
        raw, raw_residual : numpy.ndarray
            (rows, cols) frames of the confocal and of the residual view; one frame twice, except for ELSA.
        mode : Mode
            Image type.
        out : numpy.ndarray, optional
            (n, n) float32, filled and returned.
        """
        image = np.empty((self.side, self.side), np.float32) if out is None else out
        match mode:
            case Mode.LS:
                self.fill(raw, raw, ls=image)
            case Mode.RESIDUAL:
                self.fill(raw_residual, raw_residual, residual=image)
            case Mode.ELS | Mode.ELSA:
                self.fill(raw, raw_residual, els=image)
        return image


class _View:
    """A bundle view at any positions of the frame, resampled onto the common grid and multiplied by a brightness."""

    def __init__(
        self, positions: NDArray[np.float64], brightness: NDArray[np.float32], background: NDArray[np.float32] | None
    ) -> None:
        self._brightness, self._resampler = brightness, Resampler(positions)
        self._background = np.float32(0) if background is None else self._resampler.window(background)

    def __call__(self, raw: NDArray[np.generic], out: NDArray[np.float32]) -> NDArray[np.float32]:
        """Fill an image (n, n) from a raw frame (rows, cols), and return it."""
        window = np.subtract(self._resampler.window(raw), self._background, dtype=np.float32)
        return np.multiply(self._resampler(window, out), self._brightness, out=out)


class _Views:
    """The two bundle views, one after the other: for any geometry."""

    def __init__(self, confocal: View, residual: View) -> None:
        self._confocal, self._residual = confocal, residual

    def __call__(
        self,
        raw: NDArray[np.generic],
        raw_residual: NDArray[np.generic],
        ls: NDArray[np.float32] | None,
        residual: NDArray[np.float32] | None,
        els: NDArray[np.float32] | None,
    ) -> None:
        """Fill the images that are given, (n, n) float32, from the frames of the two views."""
        if ls is None and els is not None:
            ls = els
        if ls is not None:
            self._confocal(raw, ls)
        if residual is not None or els is not None:
            residual = self._residual(raw_residual, np.empty_like(els) if residual is None else residual)
        if els is not None:
            np.subtract(ls, residual, out=els)  # type: ignore[arg-type]


def line_offset_px(calibration: Calibration) -> float:
    """Return the slit offset in rows, or that of the bundle's two images where it was not measured.

    Parameters
    ----------
    calibration : Calibration
        With an offset or a bundle section; 0 without either.
    """
    if calibration.offset is not None:
        return calibration.offset.rows
    bundle = calibration.bundle
    return 0.0 if bundle is None else bundle.offset_rows


def _line_within_bundle(calibration: Calibration, side: int) -> NDArray[np.bool_]:
    """Return the pixels whose line, while their residual is read, stands within the central part of the bundle."""
    radius_px = LINE_FIELD * calibration.measured_bundle.diameter_px / 2
    axis = np.arange(side) - (side - 1) / 2
    within: NDArray[np.bool_] = np.hypot(axis[:, None] + line_offset_px(calibration), axis) < radius_px
    return within


def _check_possible(bundle: BundleSection, frame_shape: tuple[int, int]) -> None:
    """Refuse images that would exceed memory, before they are allocated."""
    if bundle.diameter_px > 2 * max(frame_shape):
        raise CalibrationError(
            f"the bundle's diameter is {bundle.diameter_px:g} px, the frame has {frame_shape[0]} x {frame_shape[1]}",
            "locate the bundle views again",
        )
