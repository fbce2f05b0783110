"""LS, ELSA and ELS+ of one moment side by side, with profiles along a line: a figure of one column's width.

Matplotlib is imported when one is drawn: panels display the images without it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import sqrt
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.processing.analysis.image_quality import Contrast, Scaling, contrast, white_levels
from napari_elsplus.processing.analysis.line_profiles import PROFILE_WIDTH_PX, LineProfiles, line_profiles
from napari_elsplus.processing.images.modes import COMPARED_MODES
from napari_elsplus.processing.images.sectioning import Mode
from napari_elsplus.workflows.pictures.curves import MODE_COLOURS, MODE_DASHES, PAPER_COLOURS

if TYPE_CHECKING:
    import os
    from collections.abc import Mapping

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    Point = tuple[float, float]

COLOURS: Final = {mode: PAPER_COLOURS[colour] for mode, colour in MODE_COLOURS.items()}
LINE_STYLES: Final = {"dotted": (0, (1, 1)), "dashed": (0, (4, 1.5)), "solid": "-"}
"""Colours and dashes of the profiles, which distinguish them without colour."""
COLUMN_MM: Final = 85.0
"""Width of the figure, millimetres: one column of most journals."""
FONT_PT: Final = 7.0
SMALL_PT: Final = 6.0
"""Of labels, and of numbers and ticks, in points; journals require at least 5 to 6."""
FIGURE_DPI: Final = 600
"""Pixels per inch of a figure saved as pixels; journals require 300 for images and 600 for line art with images."""
_PROFILE_MM: Final = 32.0
"""Height of the profiles with their labels; chosen."""
_CAPTION_MM: Final = 8.0
"""Height of the title above and the number below an image; chosen for two lines of text."""


@dataclass(frozen=True)
class ComparisonFigure:
    """LS, ELSA and ELS+ images of one raw frame, scaled for display.

    Attributes
    ----------
    images : dict
        Mode to (n, n) float32, 1 is white. `compare` scales LS and ELS+ to 0.01 % saturation each, ELSA by the factor
        of ELS+, as in the paper.
    inside : numpy.ndarray
        (n, n) bool: the disc of 90 % of the bundle, in which they are scaled and displayed.
    line : tuple
        Ends of the profiles' line, (row, col) in pixels of the images; empty for the horizontal diameter of the disc.
    line_width_px : int
        Pixels across the line that are averaged.
    um_per_px : float or None
        Micrometres per pixel; None without a scale in the calibration.
    """

    images: dict[Mode, NDArray[np.float32]]
    inside: NDArray[np.bool_]
    line: tuple[Point, Point] | tuple[()] = field(default=())
    line_width_px: int = PROFILE_WIDTH_PX
    um_per_px: float | None = None

    @property
    def ends(self) -> tuple[Point, Point]:
        """Ends of the line, (row, col): those given, or of the horizontal diameter."""
        if self.line:
            return self.line
        middle = (len(self.inside) - 1) / 2
        radius = sqrt(np.count_nonzero(self.inside) / np.pi)
        return (middle, middle - radius), (middle, middle + radius)

    def profiles(self) -> LineProfiles:
        """Return the profiles along the line."""
        return line_profiles(self.images, *self.ends, self.um_per_px, self.line_width_px)

    def contrast(self, mode: Mode | str) -> Contrast:
        """Return the contrast and the background of one mode's image, both in the 90 % disc."""
        return contrast(self.images[Mode(mode)], self.inside)

    def save(self, path: str | os.PathLike[str], *, force: bool = False) -> None:
        """Draw the images with their profiles and save the figure, 85 mm wide; pixels at 600 per inch.

        Parameters
        ----------
        path : path-like
            File of the figure; its suffix names the format: ``.png``, ``.pdf``, ``.svg``, ...
        force : bool
            Overwrite an existing file.

        Raises
        ------
        InputError
            If the format is unknown, or the file exists and `force` is not given.
        """
        from napari_elsplus.workflows.pictures.files import save_figure

        save_figure(draw_comparison(self), Path(path), force=force)


def scaled_images(
    images: Mapping[Mode, NDArray[np.float32]], inside: NDArray[np.bool_], scaling: Scaling | str = Scaling.PAPER
) -> dict[Mode, NDArray[np.float32]]:
    """Return images (n, n) by their modes whose white is 1; parameters as of :func:`white_levels`."""
    white = white_levels(images, inside, scaling)
    return {mode: image / np.float32(white[mode]) for mode, image in images.items()}


def draw_comparison(comparison: ComparisonFigure) -> Figure:
    """Draw the images and their profiles along one line, 85 mm wide, with text of at least 6 points.

    Parameters
    ----------
    comparison : ComparisonFigure
        Of `compare`, or with images scaled otherwise; without its scale there is no scale bar, and the axis of the
        profiles is in pixels.

    Returns
    -------
    matplotlib.figure.Figure
        Without a window; :func:`~napari_elsplus.workflows.pictures.files.save_figure` saves it.
    """
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    shown = [mode for mode in COMPARED_MODES if mode in comparison.images]
    image_mm = COLUMN_MM / len(shown)
    size_mm = (COLUMN_MM, image_mm + _CAPTION_MM + _PROFILE_MM)
    layout = ConstrainedLayoutEngine(w_pad=0.01, h_pad=0.01, wspace=0.02, hspace=0.02)
    figure = Figure(figsize=(size_mm[0] / 25.4, size_mm[1] / 25.4), dpi=FIGURE_DPI, layout=layout)
    axes = figure.subplot_mosaic(
        [[mode.value for mode in shown], ["profile"] * len(shown)],
        height_ratios=[image_mm + _CAPTION_MM, _PROFILE_MM],
    )
    for letter, mode in zip("abc", shown, strict=False):
        _draw_image(axes[mode.value], comparison, mode, letter)
    _draw_profiles(axes["profile"], comparison, shown)
    return figure


def _draw_image(axes: Axes, comparison: ComparisonFigure, mode: Mode, letter: str) -> None:
    image = np.nan_to_num(np.where(comparison.inside, comparison.images[mode], 0))
    axes.imshow(image, cmap="gray", vmin=0, vmax=1, interpolation="nearest")
    (row, col), (row_end, col_end) = comparison.ends
    axes.plot([col, col_end], [row, row_end], color=COLOURS[mode], linewidth=0.7, linestyle=(0, (5, 4)))
    axes.set_xlim(-0.5, len(image) - 0.5)
    axes.set_ylim(len(image) - 0.5, -0.5)
    axes.set_title(rf"$\bf{{{letter}}}$  {mode.label}", fontsize=FONT_PT, loc="left", pad=2)
    background = 100 * comparison.contrast(mode).background
    axes.set_xlabel(f"background {background:.1f} %", fontsize=SMALL_PT, labelpad=2)
    axes.set(xticks=[], yticks=[])
    axes.spines[:].set_visible(False)
    if comparison.um_per_px is not None:
        from napari_elsplus.workflows.pictures.scale_bar import draw_scale_bar

        draw_scale_bar(axes, image.shape, comparison.um_per_px, SMALL_PT)


def _draw_profiles(axes: Axes, comparison: ComparisonFigure, shown: list[Mode]) -> None:
    found = comparison.profiles()
    for mode in shown:
        (curve,) = axes.plot(found.position, found.values[mode], color=COLOURS[mode], linewidth=0.8)
        curve.set(label=mode.label, linestyle=LINE_STYLES[MODE_DASHES[mode]])
    axes.axhline(0, color="0.7", linewidth=0.5)
    unit = "\N{MICRO SIGN}m" if found.unit == "um" else "px"
    axes.set_xlabel(f"position along the line / {unit}", fontsize=FONT_PT, labelpad=2)
    axes.set_ylabel("intensity / white", fontsize=FONT_PT, labelpad=2)
    axes.tick_params(labelsize=SMALL_PT, width=0.5, length=2, pad=2)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_linewidth(0.5)
    axes.legend(
        loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=len(shown), frameon=False, fontsize=SMALL_PT,
        borderaxespad=0, handlelength=2.5,
    )  # fmt: skip
    axes.margins(x=0)
