"""Figures to files: any format that matplotlib knows by its ending, written beside and renamed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from matplotlib.backends.backend_agg import FigureCanvasAgg

from napari_elsplus.errors import InputError
from napari_elsplus.io import replacing

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.figure import Figure

DPI: Final = 120
"""Pixels for an inch of a figure."""


def save_figure(figure: Figure, path: Path, *, force: bool = False) -> None:
    """Save a figure.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        To be saved.
    path : pathlib.Path
        Where; its ending names the format.
    force : bool
        Overwrite an existing file.

    Raises
    ------
    InputError
        If the format is unknown, or the file exists and is not to be overwritten.
    """
    kind = refuse_format(path)
    with replacing(path, force=force) as unfinished:
        figure.savefig(unfinished, format=kind, dpi=DPI)


def refuse_format(path: Path) -> str:
    """Make sure that a figure can be saved under a name, and return the format that its ending names.

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
