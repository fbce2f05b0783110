"""Scale bars of pictures: a length of 1, 2 or 5 times a power of ten, in micrometres or millimetres."""

from __future__ import annotations

from math import floor, log10
from typing import TYPE_CHECKING, Final

from matplotlib.patheffects import withStroke

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MAX_SHARE: Final = 0.32
"""Largest length of a bar, relative to the picture's width; chosen."""
_LINE: Final = 0.2
"""Thickness of the bar and of the label's outline, relative to the label's size; chosen."""


def draw_scale_bar(
    axes: Axes, shape: tuple[int, ...], um_per_px: float, font_pt: float, *, corner: tuple[float, float] = (0, 0)
) -> None:
    """Draw a white scale bar with its length into the lower right corner of an image.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
        Displays the image.
    shape : tuple of int
        Rows and columns of the image.
    um_per_px : float
        Micrometres per pixel of the image.
    font_pt : float
        Size of the label, points.
    corner : tuple of float
        Row and column of the image's first pixel on the axes.
    """
    rows, cols = shape
    length_um = bar_length(MAX_SHARE * cols * um_per_px)
    top, left = corner
    right, bottom = left + 0.97 * cols, top + 0.96 * rows
    axes.plot(
        [right - length_um / um_per_px, right], [bottom] * 2, color="white", linewidth=_LINE * font_pt,
        solid_capstyle="butt", scalex=False, scaley=False,
    )  # fmt: skip
    outline = [withStroke(linewidth=_LINE * font_pt, foreground="black")]
    axes.text(
        right, top + 0.94 * rows, length_label(length_um), color="white", ha="right", va="bottom", fontsize=font_pt,
        path_effects=outline,
    )  # fmt: skip


def length_label(length_um: float) -> str:
    """Return a length in micrometres, or in millimetres from 1 mm.

    Examples
    --------
    >>> length_label(200.0), length_label(2000.0)
    ('200 µm', '2 mm')
    """
    return f"{length_um / 1000:g} mm" if length_um >= 1000 else f"{length_um:g} \N{MICRO SIGN}m"


def bar_length(longest: float) -> float:
    """Return the largest of 1, 2 and 5 times a power of ten that is not longer than `longest`.

    Examples
    --------
    >>> bar_length(730.0), bar_length(0.03), bar_length(1999.0)
    (500.0, 0.02, 1000.0)
    """
    power = 10.0 ** floor(log10(longest))
    return next(step * power for step in (5, 2, 1) if step * power <= longest * (1 + 1e-9))
