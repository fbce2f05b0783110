"""Save figures in any format of matplotlib, each written beside its target and renamed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import cv2
import numpy as np
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg

from napari_elsplus.io import refuse_suffix, replacing

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.figure import Figure

TRUE_TYPE: Final = 42
"""Matplotlib's name for fonts that editors of PDF files can edit."""
DPI: Final = 120
"""Pixels per inch of a figure; chosen, the figures are then 800 to 1500 pixels wide."""


def save_figure(figure: Figure, path: Path, *, force: bool = False) -> None:
    """Save a figure to a file whose suffix names the format; one with a higher resolution of its own keeps that.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        To be saved.
    path : pathlib.Path
        The file.
    force : bool
        Overwrite an existing file.

    Raises
    ------
    InputError
        If the format is unknown, or the file exists and is not to be overwritten.
    """
    kind = refuse_format(path)
    with replacing(path, force=force) as unfinished, rc_context({"pdf.fonttype": TRUE_TYPE}):
        figure.savefig(unfinished, format=kind, dpi=max(DPI, figure.dpi))


def save_grey_figure(figure: Figure, path: Path, *, force: bool = False) -> None:
    """Save a figure without colours as a PNG of grey levels, in less than half the time of :func:`save_figure`.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        To be saved; of colours, the red channel.
    path : pathlib.Path
        The file.
    force : bool
        Overwrite an existing file.

    Raises
    ------
    InputError
        If the file exists and is not to be overwritten.
    """
    canvas: Any = FigureCanvasAgg(figure)  # matplotlib does not type it
    canvas.draw()
    grey = np.ascontiguousarray(np.asarray(canvas.buffer_rgba())[..., 0])
    with replacing(path, force=force) as unfinished:
        unfinished.write_bytes(cv2.imencode(".png", grey)[1].tobytes())


def refuse_format(path: Path) -> str:
    """Return the figure format that the suffix of a path names; refuse an unknown one.

    Raises
    ------
    InputError
        If the format is unknown.
    """
    refuse_suffix(path, *(f".{kind}" for kind in sorted(FigureCanvasAgg.get_supported_filetypes())))
    return path.suffix.lstrip(".").lower()
