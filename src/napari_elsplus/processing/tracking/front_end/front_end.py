"""From a raw frame to the image that is tracked and laid into the mosaic, in one pass over the camera's memory.

What the paper does in steps (background, split, subtract, smooth, down-sample), fused: the two views are binned onto a
coarser grid while they are read, the residual with its sub-pixel alignment in the binning weights, subtracted signed,
smoothed over about one core, and divided by the flat. Thrapp and Hughes, Methods, "Image Processing".
"""

from __future__ import annotations

import itertools
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING, Any, Final

import cv2
import numpy as np
from scipy.ndimage import affine_transform, uniform_filter

from napari_elsplus.errors import CalibrationError, InputError
from napari_elsplus.instrument.frame_region import require_frame_shape
from napari_elsplus.processing.analysis.saturation import MAX_SATURATED_PIXELS, saturation_level
from napari_elsplus.processing.compiled import resolved_once
from napari_elsplus.processing.images.hot_pixels import HotPixels
from napari_elsplus.processing.images.resampling import cropped
from napari_elsplus.processing.images.sectioning import Mode, line_offset_px
from napari_elsplus.processing.tracking.front_end.binned_blocks import CAMERA_KINDS
from napari_elsplus.processing.tracking.front_end.binning import scratch, subtract_views, survey, view_blocks
from napari_elsplus.processing.tracking.front_end.grid import GRID_DIAMETER_PX, Grid, lit_pixels
from napari_elsplus.processing.tracking.front_end.saturated_light import SaturatedLight

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import Calibration

MIN_SEEN: Final = 0.5
"""Part of the disc's height and width that the frame must contain in both views; chosen: two frames that overlap by
half are registered, and calibration refuses views of which less than 90 % are seen."""
DARK_PERCENTILE: Final = 5.0
"""Of the background's pixels, which lie beside the views; chosen."""
MAX_SATURATED: Final = 0.25
"""Share of the confocal view's middle, above which it is not tracked; chosen: of three rigs on tissue two were tracked
wrongly with 0.4 and 0.6, and one rightly with 0.12."""
MAX_SATURATED_SEEN: Final = 0.6
"""The same where the background shows the cores, so that what saturated pixels lack is estimated; chosen."""
_EVERY_PX: Final = 8
"""Rows and columns of the middle of a view of which one is read; chosen: about a thousand pixels in all."""
_LOWEST_FLAT: Final = 0.05
"""Of the light of a whole bundle that is divided by at least; chosen: with 0.2 clusters of dead cores stay dark, which
does not move with the scene; with 0.1 one of 312 registrations through a bundle with 20 % of dead cores is wrong."""
_FLAT_ROUNDS: Final = 5
"""Iterations in which the flat is freed of its resampling; chosen: with more the pattern that stays is as large."""
_BINOMIAL: Final = np.array([1, 4, 6, 4, 1], np.float32)


class FrontEnd:
    """Turns raw frames into tracking images; built once per calibration, allocates nothing per frame.

    Parameters
    ----------
    calibration : Calibration
        Needs the bundle section; background, flat and rows per frame are used where they are known.
    frame_shape : tuple of int
        Rows and columns of the raw frames.
    mode : Mode
        Which image is made.
    diameter_px : float
        Of the bundle on the grid, as of :meth:`Grid.of`.

    Raises
    ------
    CalibrationError
        If the bundle was not located, lies outside of such a frame, or was measured on frames of another size.
    """

    def __init__(
        self,
        calibration: Calibration,
        frame_shape: tuple[int, int],
        mode: Mode = Mode.ELS,
        diameter_px: float = GRID_DIAMETER_PX,
    ) -> None:
        grid = Grid.of(calibration, diameter_px)
        require_frame_shape(calibration, frame_shape)
        self._frame_shape = (int(frame_shape[0]), int(frame_shape[1]))
        bundle, q, subtracts = calibration.measured_bundle, grid.binning, mode in (Mode.ELS, Mode.ELSA)
        to_residual = np.linalg.inv(np.vstack([bundle.residual_to_confocal, (0.0, 0.0, 1.0)]))[:2]
        of_confocal, of_residual = {Mode.LS: (1.0, 0.0), Mode.RESIDUAL: (0.0, 1.0)}.get(mode, (1.0, -1.0))
        weights = of_confocal / q**2, of_residual / bundle.residual_gain / q**2
        # maps of the views that are read, from camera pixels counted from the grid's corner to those of the frame
        self._views = [
            (np.column_stack([view[:, :2], view[:, 2] + view[:, :2] @ grid.origin]), weight)
            for view, weight in zip((np.eye(3)[:2], to_residual), weights, strict=True)
            if weight
        ]
        views = [view for view, _ in self._views]
        seen = _seen(grid, views, self._frame_shape)
        # where the line has left the bundle while the residual is read haze is left, which stands still
        self.sectioned = replace(grid, seen=seen, line_offset=line_offset_px(calibration) / q if subtracts else 0.0)
        self.grid = grid if seen is None else self.sectioned
        lit = lit_pixels(*self.grid.spans(1.0))
        # a view of weight zero is taken from where the other one lies
        self._blocks = view_blocks(views[0], views[-1], q, lit, self._frame_shape)
        self._weights, self._pixels = (np.float32(weights[0]), np.float32(weights[1])), tuple(range(q))
        self._scratch = scratch(grid.side)
        reach = grid.side * q
        self._middle = tuple(slice(at + reach // 4, at + 3 * reach // 4, _EVERY_PX) for at in grid.origin)
        inside = lit.astype(np.float32)
        light = _smooth(inside)
        if calibration.flat is not None:
            light = np.maximum(_smooth(inside * self._binned_flat(calibration.flat)), _LOWEST_FLAT * light)
        self._scale = np.divide(inside, light, out=np.zeros_like(light), where=inside > 0)
        background = np.zeros(frame_shape, np.float32) if calibration.background is None else calibration.background
        self._hot_pixels = HotPixels(background)
        mended = self._hot_pixels.mended(background)
        self._offset = self._scale * _smooth(inside * self._binned(mended))
        black, level = float(np.percentile(background, DARK_PERCENTILE)), float(background[self._middle].mean())
        self._dark_level = (level + black) / 2
        self._saturated = SaturatedLight(mended, black, level, q + 2)

    def image(
        self, raw: NDArray[Any], out: NDArray[np.float32], raw_residual: NDArray[Any] | None = None
    ) -> NDArray[np.float32]:
        """Make the tracking image of a raw frame; zero if the confocal view shows nothing that moves.

        It shows but the background and the cores, whose patterns stand still, where much of it is saturated, all of it
        is at one level, or half of the background's light is missing: the laser is off.

        Parameters
        ----------
        raw : numpy.ndarray
            (rows, cols) raw frame, integer or float.
        out : numpy.ndarray
            (n, n) float32, C-contiguous: filled with signed grey levels.
        raw_residual : numpy.ndarray, optional
            The frame that the residual is taken from, in ELSA.

        Raises
        ------
        InputError
            If a frame has another size.
        """
        for frame in (raw, raw_residual):
            if frame is not None and frame.shape != self._frame_shape:
                raise InputError(
                    f"a frame has {frame.shape} pixels, the calibration is for {self._frame_shape}",
                    "all frames of a recording must have one size",
                )
        frame = _readable(raw)
        part = frame[self._middle]
        limit = saturation_level(part)
        level, saturated, even = survey(part, limit)
        seen = self._saturated.known(limit)
        if even or level < self._dark_level or saturated > (MAX_SATURATED_SEEN if seen else MAX_SATURATED):
            out[:] = 0
            return out
        confocal = residual = self._mended(frame)
        if raw_residual is not None and raw_residual is not raw:
            residual = self._mended(raw_residual)
        self._fill(confocal, residual, self._offset, out)
        if seen and saturated > MAX_SATURATED_PIXELS and self._saturated_share(frame, limit) > MAX_SATURATED_PIXELS:
            self._add_beyond(confocal, residual, limit, out)
        return out

    def _mended(self, frame: NDArray[Any]) -> NDArray[Any]:
        return _readable(self._hot_pixels.mended(frame))

    def _saturated_share(self, frame: NDArray[Any], limit: float) -> float:
        """Return the share of saturated pixels in the middle of the confocal view, of which :func:`survey` sees few."""
        middle = frame[tuple(slice(along.start, along.stop) for along in self._middle)]
        return float(np.count_nonzero(middle == limit) / middle.size)

    def _fill(
        self, raw: NDArray[Any], raw_residual: NDArray[Any], offset: NDArray[np.float32], out: NDArray[np.float32]
    ) -> None:
        subtract = _subtract_views(raw.dtype, raw_residual.dtype, self.grid.binning)
        subtract(
            raw, raw_residual, self._pixels, self._blocks, self._weights, self._scale, offset, self._scratch, out
        )  # fmt: skip

    def _add_beyond(
        self, raw: NDArray[Any], raw_residual: NDArray[Any], limit: float, out: NDArray[np.float32]
    ) -> None:
        """Add the light that saturated pixels did not show."""
        confocal, unit = self._saturated.beyond(raw, limit)
        residual = confocal if raw_residual is raw else self._saturated.beyond(raw_residual, limit)[0]
        more = np.empty_like(out)
        self._fill(_readable(confocal), _readable(residual), np.zeros_like(out), more)
        out += np.float32(unit) * more

    def _binned(self, frame: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return both views of a frame, (n, n), binned and weighted, as the kernel does.

        By interpolation, since the kernel would have to be compiled for float32, which takes seconds.
        """
        side, q = self.grid.side, self.grid.binning
        half, total = 0.5 * (q - 1), np.zeros((side, side), np.float32)
        squares = q**2 * uniform_filter(frame, q, np.float64, origin=-(q // 2))  # from their first pixels on
        for view, weight in self._views:
            first = view @ (half, half, 1.0) - half
            total += weight * affine_transform(squares, q * view[:, :2], first, total.shape, order=1)
        return total

    def _binned_flat(self, flat: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the flat, whose middle is the bundle's centre, on the grid.

        It was resampled, by which the cores lost contrast that they have in frames. What is binned is the image in the
        camera's pixels whose resampling it is, by Landweber's iteration.
        """
        grid, q = self.grid, self.grid.binning
        side, middle = grid.side * q, (len(flat) - 1) / 2
        from_middle = np.multiply(grid.centre, q) + (q - 1) / 2 - (side - 1) / 2
        there, back = tuple(middle - from_middle), tuple((side - 1) / 2 + from_middle)
        left, fine = flat - 1, np.zeros((side, side), np.float32)
        for _ in range(_FLAT_ROUNDS):
            fine += cropped(left, there, side)
            left = flat - 1 - cropped(fine, back, len(flat))
        binned: NDArray[np.float32] = 1 + fine.reshape(grid.side, q, grid.side, q).mean(axis=(1, 3))
        return binned


@cache
def _subtract_views(*kinds: Any) -> Callable[..., None]:
    """Return the kernel for frames of one kind of pixels each, and one binning."""
    del kinds
    return resolved_once(subtract_views)


def _readable(frame: NDArray[Any]) -> NDArray[Any]:
    """Return a frame as kernels are compiled for: read-only, as those of a file are, and without gaps.

    Numbers that no camera delivers become float32.
    """
    view = np.ascontiguousarray(frame, frame.dtype if frame.dtype in CAMERA_KINDS else np.float32).view()
    view.flags.writeable = False
    return view


def _smooth(image: NDArray[np.float32]) -> NDArray[np.float32]:
    smooth: NDArray[np.float32] = cv2.sepFilter2D(image, -1, _BINOMIAL, _BINOMIAL, borderType=cv2.BORDER_CONSTANT)
    return smooth


def _seen(
    grid: Grid, views: list[NDArray[np.float64]], frame_shape: tuple[int, int]
) -> tuple[int, int, int, int] | None:
    """Return the part of the grid that lies within the frame in all views; None if the whole disc does.

    Raises
    ------
    CalibrationError
        If less than :data:`MIN_SEEN` of the disc's height or width does.
    """
    lit = np.stack(np.nonzero(lit_pixels(*grid.spans(1.0))))
    within, q = np.ones(lit.shape, bool), grid.binning
    for view, u, v in itertools.product(views, (0, q - 1), (0, q - 1)):
        at = np.floor(view @ [*(q * lit + [[u], [v]]), np.ones(lit.shape[1])])
        within &= (at >= 0) & (at + 2 <= np.reshape(frame_shape, (2, 1)))
    if within.all():
        return None
    # rows are lost beyond the first and last row of the frame, columns beyond its sides
    rows, cols = (np.setdiff1d(lines, lines[~inside]).tolist() for lines, inside in zip(lit, within, strict=True))
    share = min(len(rows), len(cols)) / np.ptp(lit[0])
    if share < MIN_SEEN:
        raise CalibrationError(
            f"{100 * (1 - share):.0f} % of the bundle's views lie outside of the "
            f"{frame_shape[0]} x {frame_shape[1]} frame",
            "record a larger region, or locate the bundle views again",
        )
    return rows[0], rows[-1] + 1, cols[0], cols[-1] + 1
