"""From a raw frame to the image that is tracked and laid into the mosaic, in one pass over the camera's memory.

What the paper does in steps (background, split, subtract, smooth, down-sample), fused: the two views are binned onto a
coarser grid while they are read, the residual with its sub-pixel alignment in the binning weights, subtracted signed,
smoothed over about one core, and divided by the flat. Thrapp and Hughes, Methods, "Image Processing".
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import cv2
import numpy as np

from napari_elsplus.compiled import kernel
from napari_elsplus.errors import CalibrationError, InputError
from napari_elsplus.processing.grid import Grid
from napari_elsplus.processing.sectioning import Mode

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.calibration import Calibration

_LOWEST_FLAT: Final = 0.2
_EPSILON: Final = 1e-6


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

    Raises
    ------
    CalibrationError
        If the bundle was not located, or lies outside of such a frame.
    """

    def __init__(self, calibration: Calibration, frame_shape: tuple[int, int], mode: Mode = Mode.ELS) -> None:
        self.grid = grid = Grid.of(calibration)
        self._frame_shape = (int(frame_shape[0]), int(frame_shape[1]))
        assert calibration.bundle is not None
        bundle, q = calibration.bundle, grid.binning
        to_residual = np.linalg.inv(np.vstack([bundle.residual_to_confocal, (0.0, 0.0, 1.0)]))[:2]
        gain = bundle.residual_gain
        self._confocal = _Binning(grid, np.eye(3)[:2], frame_shape, 0.0 if mode is Mode.RESIDUAL else 1 / q**2)
        sign = {Mode.LS: 0.0, Mode.RESIDUAL: 1.0, Mode.ELS: -1.0, Mode.ELSA: -1.0}[mode]
        self._residual = _Binning(grid, to_residual, frame_shape, sign / gain / q**2)
        self._sum = np.zeros((grid.side, grid.side), np.float32)
        self._line = np.zeros(max(frame_shape[1], grid.side) + 4, np.float32)
        self._none = np.zeros_like(self._sum)
        self.lit = first, last = grid.spans(1.0)
        columns = np.arange(grid.side)
        inside = ((columns >= first[:, None]) & (columns < last[:, None])).astype(np.float32)
        weights = np.empty_like(self._sum)
        smooth(inside, np.ones_like(inside), self._none, self._line, weights)
        self._scale = np.divide(inside, weights, out=np.zeros_like(inside), where=weights > 0)
        if calibration.flat is not None:
            flat = np.empty_like(self._sum)
            smooth(inside * self._binned_flat(calibration.flat), self._scale, self._none, self._line, flat)
            self._scale /= np.maximum(flat, _LOWEST_FLAT)
        self._offset = np.zeros_like(self._sum)
        if calibration.background is not None:
            if calibration.background.shape != tuple(frame_shape):
                raise CalibrationError(
                    f"the calibration's background has {calibration.background.shape} pixels, the frames {frame_shape}",
                    "use the calibration that was made with this camera region",
                )
            background = np.ascontiguousarray(calibration.background, np.float32)
            self._accumulate(background, background)
            smooth(self._sum, self._scale, self._none, self._line, self._offset)

    def image(
        self, raw: NDArray[Any], out: NDArray[np.float32], raw_residual: NDArray[Any] | None = None
    ) -> NDArray[np.float32]:
        """Make the tracking image of a raw frame.

        Parameters
        ----------
        raw : numpy.ndarray
            (rows, cols) raw frame, integer or float.
        out : numpy.ndarray
            (n, n) float32: filled with signed grey levels.
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
        self._accumulate(raw, raw if raw_residual is None else raw_residual)
        smooth(self._sum, self._scale, self._offset, self._line, out)
        return out

    def saturated(self, raw: NDArray[Any]) -> bool:
        """Whether most of the confocal view is at the camera's limit, so that only the flat field has structure."""
        if raw.dtype.kind != "u":
            return False
        grid = self.grid
        top, left = grid.origin
        reach = grid.side * grid.binning
        view = raw[top + reach // 4 : top + 3 * reach // 4 : 8, left + reach // 4 : left + 3 * reach // 4 : 8]
        return bool(np.count_nonzero(view == np.iinfo(raw.dtype).max) > 0.5 * view.size)

    def _accumulate(self, raw: NDArray[Any], raw_residual: NDArray[Any]) -> None:
        self._sum[:] = 0
        first, last = self.lit
        for view, frame in ((self._confocal, raw), (self._residual, raw_residual)):
            if view.weight:
                bin_view(frame, view.matrix, self.grid.binning, view.weight, first, last, self._line, self._sum)

    def _binned_flat(self, flat: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the flat, whose middle is the bundle's centre, on the grid."""
        grid, q = self.grid, self.grid.binning
        where = (np.arange(grid.side * q) + 0.5) / q - 0.5
        rows, cols = (
            ((where - c) * q + (n - 1) / 2).astype(np.float32) for c, n in zip(grid.centre, flat.shape, strict=True)
        )
        fine = cv2.remap(flat, *np.meshgrid(cols, rows), cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        binned: NDArray[np.float32] = fine.reshape(grid.side, q, grid.side, q).mean(axis=(1, 3))
        return binned


class _Binning:
    """Where the grid's pixels lie in one view of the frame."""

    def __init__(
        self, grid: Grid, from_confocal: NDArray[np.float64], frame_shape: tuple[int, int], weight: float
    ) -> None:
        self.weight = weight
        self.matrix = from_confocal.copy()
        self.matrix[:, 2] += from_confocal[:, :2] @ grid.origin  # from camera pixels counted from the grid's corner
        first, last = grid.spans(1.0)
        rows = np.flatnonzero(last > first)
        q = grid.binning
        edge = [(q * r + u, q * c + u) for r in rows for c in (first[r], last[r] - 1) for u in (0, q - 1)]
        there = np.column_stack([edge, np.ones(len(edge))]) @ self.matrix.T
        low, high = np.floor(there.min(axis=0)), np.floor(there.max(axis=0)) + 2
        if weight and (low.min() < 0 or (high > frame_shape).any()):
            raise CalibrationError(
                f"a bundle image reaches from ({low[0]:.0f}, {low[1]:.0f}) to ({high[0]:.0f}, {high[1]:.0f}), "
                f"outside of the {frame_shape[0]} x {frame_shape[1]} frame",
                "locate the pair again, or record a larger region",
            )


@kernel
def bin_view(
    raw: NDArray[Any],
    matrix: NDArray[np.float64],
    binning: int,
    weight: float,
    first: NDArray[np.int32],
    last: NDArray[np.int32],
    line: NDArray[np.float32],
    out: NDArray[np.float32],
) -> None:
    """Add a view, binned onto the grid with bilinear weights and times `weight`, to `out`.

    `matrix` maps (row, col) counted in camera pixels from the grid's corner to (row, col) in the frame. It differs
    little from a translation, so that the whole-pixel shifts are constant over long runs of columns.
    """
    half = 0.5 * (binning - 1)
    slope = matrix[0, 1] / matrix[1, 1]  # rows per column, along the view's own columns
    growth = binning * (matrix[1, 1] - 1.0)
    for i in range(out.shape[0]):
        begin, end = first[i], last[i]
        if end <= begin:
            continue
        row = binning * i + half
        # leftmost camera column of the grid's column j: shift + growth * j + binning * j
        shift = matrix[1, 0] * row + matrix[1, 1] * half + matrix[1, 2] - half
        left = int(np.floor(shift + growth * begin + _EPSILON)) + binning * begin
        right = int(np.floor(shift + growth * (end - 1) + _EPSILON)) + binning * end
        top = matrix[0, 0] * row + matrix[0, 2] - half + slope * (left - matrix[1, 0] * row - matrix[1, 2])
        _sum_rows(raw, top, slope, left, right + 1, binning, line)
        _sum_columns(line, shift, growth, left, begin, end, binning, weight, out[i])


@kernel
def _sum_rows(
    raw: NDArray[Any], top: float, slope: float, left: int, right: int, binning: int, line: NDArray[np.float32]
) -> None:
    """Sum `binning` rows from row `top` + `slope` * k downwards, in each column `left` + k up to `right`."""
    width = min(right, raw.shape[1]) - left
    line[width] = line[width + 1] = np.float32(0)
    if slope == 0.0:
        above = int(np.floor(top + _EPSILON))
        _sum_rows_of_run(raw, above, max(top - above, 0.0), 0.0, left, 0, width, binning, line)
        return
    begin = 0
    while begin < width:
        above = int(np.floor(top + slope * begin + _EPSILON))
        edge = above + 1 if slope > 0 else above
        end = min(width, max(begin + 1, int(np.ceil((edge - top) / slope))))
        down = max(top + slope * begin - above, 0.0)
        _sum_rows_of_run(raw, above, down, slope, left, begin, end, binning, line)
        begin = end


@kernel
def _sum_rows_of_run(
    raw: NDArray[Any],
    above: int,
    down: float,
    slope: float,
    left: int,
    begin: int,
    end: int,
    binning: int,
    line: NDArray[np.float32],
) -> None:
    """Sum rows whose whole shift is constant; slices made in a loop would cost more than the sums."""
    one, d, g = np.float32(1), np.float32(down), np.float32(slope)
    upper, lower = raw[above, left + begin : left + end], raw[above + binning, left + begin : left + end]
    second = raw[above + min(1, binning - 1), left + begin : left + end]
    into = line[begin:end]
    if binning == 1:
        for k in range(end - begin):
            f = d + g * np.float32(k)
            into[k] = (one - f) * np.float32(upper[k]) + f * np.float32(lower[k])
        return
    for k in range(end - begin):
        f = d + g * np.float32(k)
        into[k] = (one - f) * np.float32(upper[k]) + np.float32(second[k]) + f * np.float32(lower[k])
    for r in range(2, binning):
        for k in range(begin, end):
            line[k] += np.float32(raw[above + r, left + k])


@kernel
def _sum_columns(
    line: NDArray[np.float32],
    shift: float,
    growth: float,
    left: int,
    begin: int,
    end: int,
    binning: int,
    weight: float,
    out: NDArray[np.float32],
) -> None:
    """Add to each grid column the weighted sum of `binning` columns of the line."""
    if growth == 0.0:
        whole = int(np.floor(shift + _EPSILON))
        across = max(shift - whole, 0.0)
        start = binning * begin + whole - left
        _sum_columns_of_run(line, start, across, 0.0, binning, weight, out, begin, end)
        return
    j = begin
    while j < end:
        whole = int(np.floor(shift + growth * j + _EPSILON))
        edge = whole + 1 if growth > 0 else whole
        stop = min(end, max(j + 1, int(np.ceil((edge - shift) / growth))))
        across = max(shift + growth * j - whole, 0.0)
        start = binning * j + whole - left
        _sum_columns_of_run(line, start, across, growth, binning, weight, out, j, stop)
        j = stop


@kernel
def _sum_columns_of_run(
    line: NDArray[np.float32],
    start: int,
    across: float,
    growth: float,
    binning: int,
    weight: float,
    out: NDArray[np.float32],
    begin: int,
    end: int,
) -> None:
    """Add columns whose whole shift is constant."""
    one, a, g, w = np.float32(1), np.float32(across), np.float32(growth), np.float32(weight)
    source, into = line[start:], out[begin:end]
    if binning == 1:
        for k in range(end - begin):
            f = a + g * np.float32(k)
            into[k] += w * ((one - f) * source[k] + f * source[k + 1])
    elif binning == 2:
        for k in range(end - begin):
            f = a + g * np.float32(k)
            into[k] += w * ((one - f) * source[2 * k] + source[2 * k + 1] + f * source[2 * k + 2])
    else:
        for k in range(end - begin):
            f = a + g * np.float32(k)
            total = (one - f) * source[binning * k] + f * source[binning * (k + 1)]
            for b in range(1, binning):
                total += source[binning * k + b]
            into[k] += w * total


@kernel
def smooth(
    image: NDArray[np.float32],
    scale: NDArray[np.float32],
    offset: NDArray[np.float32],
    line: NDArray[np.float32],
    out: NDArray[np.float32],
) -> None:
    """Smooth with the binomial kernel 1 4 6 4 1 (a Gaussian of 1 px), multiply by `scale`, subtract `offset`.

    `image` is zero outside the disc; `line` is scratch of a row and four pixels.
    """
    height, width = image.shape
    four, six = np.float32(4), np.float32(6)
    out[:2] = np.float32(0)
    out[height - 2 :] = np.float32(0)
    line[:2] = np.float32(0)
    line[width + 2 :] = np.float32(0)
    for i in range(2, height - 2):
        a, b, c, d, e = image[i - 2], image[i - 1], image[i], image[i + 1], image[i + 2]
        into = line[2 : width + 2]
        for k in range(width):
            into[k] = a[k] + e[k] + four * (b[k] + d[k]) + six * c[k]
        l0, l1, l2, l3, l4 = (
            line[:width],
            line[1 : width + 1],
            line[2 : width + 2],
            line[3 : width + 3],
            line[4 : width + 4],
        )
        factor, less, result = scale[i], offset[i], out[i]
        for k in range(width):
            result[k] = factor[k] * (l0[k] + l4[k] + four * (l1[k] + l3[k]) + six * l2[k]) - less[k]
