"""Profiles of several images along one line."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from skimage.measure import profile_line

from napari_elsplus.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from napari_elsplus.processing.images.sectioning import Mode

    Image = NDArray[np.float32]
    Point = tuple[float, float]

PROFILE_WIDTH_PX: Final = 5
"""Default width over which profiles are averaged, pixels; chosen, a few cores."""


@dataclass(frozen=True)
class LineProfiles:
    """Line profiles of several images.

    Attributes
    ----------
    position : numpy.ndarray
        (m,), from the line's start, in `unit`.
    values : dict
        Mode to (m,) grey levels, the mean over the width of the line.
    unit : str
        ``"um"`` or ``"px"``.
    """

    position: NDArray[np.float64]
    values: dict[Mode, NDArray[np.float64]]
    unit: str


def line_profiles(
    images: Mapping[Mode, Image],
    start: Point,
    end: Point,
    um_per_px: float | None = None,
    width_px: int = PROFILE_WIDTH_PX,
) -> LineProfiles:
    """Return profiles of several images along one line.

    Parameters
    ----------
    images : mapping
        Mode to (n, n) grey levels.
    start, end : tuple of float
        Ends of the line, (row, col) in pixels of the images.
    um_per_px : float, optional
        Scale of the positions; pixels if unknown.
    width_px : int
        Pixels across the line that are averaged.

    Returns
    -------
    LineProfiles
        One value per pixel of the line's length.

    Raises
    ------
    InputError
        If the line is shorter than a pixel, or lies outside the images.
    """
    length_px = float(np.hypot(*np.subtract(end, start)))
    if not length_px >= 1:
        raise InputError(f"the line is {length_px:.1f} px long", "draw a longer one")
    side = len(next(iter(images.values())))
    if max(*start, *end) < 0 or min(*start, *end) > side - 1:
        raise InputError("the line lies outside the images", "draw it across one of them")
    values = {
        mode: profile_line(image, start, end, linewidth=width_px, order=1, mode="constant", cval=0.0)
        for mode, image in images.items()
    }
    step = um_per_px or 1.0
    count = len(next(iter(values.values())))
    return LineProfiles(np.arange(count, dtype=np.float64) * step, values, "um" if um_per_px else "px")
