"""Textures from given data: bar targets, and images."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

from napari_elsplus.errors import InputError
from napari_elsplus.simulation.specimen.textures import step_um

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.simulation.specimen.textures import Axis, Picture


@dataclass(frozen=True)
class Bars:
    """Clear bars on an opaque ground, each (first row, first column, last row, last column) in micrometres."""

    bars_um: tuple[tuple[float, float, float, float], ...]
    bounds_um: None = None

    def sample(self, rows_um: Axis, cols_um: Axis) -> Picture:
        """Return the clear fraction of each cell of a grid with these rows and columns, um."""
        out = np.zeros((len(rows_um), len(cols_um)), np.float32)
        for top, left, bottom, right in self.bars_um:
            down, across = _covered(rows_um, top, bottom), _covered(cols_um, left, right)
            if down.any() and across.any():
                out += np.outer(down, across).astype(np.float32)
        return out


def usaf_1951(groups: tuple[int, ...] = (4, 5, 6, 7)) -> Bars:
    """Return a USAF 1951 target of these groups: three bars each way of 2**(group + (element - 1) / 6) pairs/mm."""
    bars: list[tuple[float, float, float, float]] = []
    top = -240.0
    for group in groups:
        left = -250.0
        tallest = 0.0
        for element in range(1, 7):
            width = 500 / 2 ** (group + (element - 1) / 6)
            tallest = max(tallest, 5 * width)
            for n in range(3):
                bars.append((top + 2 * n * width, left, top + (2 * n + 1) * width, left + 5 * width))
                bars.append((top, left + (6 + 2 * n) * width, top + 5 * width, left + (7 + 2 * n) * width))
            left += 13 * width
            if left > 250:
                left = -250.0
                top += tallest + 2 * width
                tallest = 0.0
        top += tallest + 8.0
    return Bars(tuple(bars))


class ImageTexture:
    """An image as a plane; its middle is the origin of the scene.

    Parameters
    ----------
    picture : numpy.ndarray
        Grey image (rows, cols), any numeric type; brightness 1 at its largest value.
    um_per_px : float
        Micrometres per pixel of the picture.

    Raises
    ------
    InputError
        If it is no grey image, holds NaN, or is black.
    """

    def __init__(self, picture: NDArray[np.generic], um_per_px: float) -> None:
        if picture.ndim != 2 or min(picture.shape) < 2:
            raise InputError(f"a scene image of shape {picture.shape}", "give a grey image (rows, cols)")
        if not um_per_px > 0:
            raise InputError(f"the scene image has {um_per_px} um per pixel", "it must be a positive number")
        values = np.ascontiguousarray(picture, dtype=np.float32)
        largest = float(values.max())
        if not (np.isfinite(values).all() and largest > 0):
            raise InputError(f"the scene image's largest value is {largest}", "give an image with light in it")
        self._picture: Picture = (np.maximum(values, 0) / largest).astype(np.float32)
        self._um_per_px = um_per_px
        half_rows, half_cols = (0.5 * (n - 1) * um_per_px for n in picture.shape)
        self.bounds_um: tuple[float, float, float, float] | None = (-half_rows, -half_cols, half_rows, half_cols)
        self._shrunk: dict[int, Picture] = {1: self._picture}

    def sample(self, rows_um: Axis, cols_um: Axis) -> Picture:
        """Return the brightness on a regular grid of rows and columns, um, bilinear; mirrored beyond the edge."""
        factor = max(1, int(step_um(rows_um) / (2 * self._um_per_px)))
        if factor not in self._shrunk:
            shape = [max(1, n // factor) for n in self._picture.shape]
            cut = self._picture[: shape[0] * factor, : shape[1] * factor]
            self._shrunk[factor] = cv2.resize(cut, (shape[1], shape[0]), interpolation=cv2.INTER_AREA)
        px = self._um_per_px
        rows, cols = (
            ((axis / px + 0.5 * (n - 1) + 0.5) / factor - 0.5).astype(np.float32)
            for axis, n in zip((rows_um, cols_um), self._picture.shape, strict=True)
        )
        grid_cols, grid_rows = np.meshgrid(cols, rows)
        return cv2.remap(  # type: ignore[no-any-return]
            self._shrunk[factor], grid_cols, grid_rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT
        )


def _covered(axis_um: Axis, first: float, last: float) -> Axis:
    step = step_um(axis_um)
    return np.asarray(
        np.clip(np.minimum(last, axis_um + step / 2) - np.maximum(first, axis_um - step / 2), 0, None) / step
    )
