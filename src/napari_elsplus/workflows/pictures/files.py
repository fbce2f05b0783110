"""Save figures in any format of matplotlib, each written beside its target and renamed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg

from napari_elsplus.errors import InputError
from napari_elsplus.io import replacing

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


def refuse_format(path: Path) -> str:
    """Return the figure format that the suffix of a path names; refuse an unknown one.

    Raises
    ------
    InputError
        If the format is unknown.
    """
    kind = path.suffix.lstrip(".").lower()
    known = FigureCanvasAgg.get_supported_filetypes()
    if kind not in known:
        raise InputError(f"a figure cannot be saved as {path.name}", f"end its name in .{', .'.join(sorted(known))}")
    return kind
