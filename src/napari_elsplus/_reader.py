"""The napari reader: recordings of any registered format, and calibration files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from napari.utils.notifications import show_error, show_info, show_warning

from napari_elsplus.errors import ElsPlusError
from napari_elsplus.io import settings
from napari_elsplus.io.calibration_lookup import is_calibration
from napari_elsplus.io.formats.registry import CALIBRATION
from napari_elsplus.viewing.layers import open_layers
from napari_elsplus.viewing.outlines import calibration_layers

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    Reader = Callable[[str | Sequence[str]], list[tuple[Any, ...]]]

NO_LAYERS: Final[list[tuple[Any, ...]]] = [(None,)]
"""By napari's convention: the file was read, and there is no layer to add."""


def get_reader(path: str | Sequence[str]) -> Reader | None:
    """Return the function that reads a path to layers, or None if it is no recording and no calibration.

    Parameters
    ----------
    path : str or sequence of str
        Dropped on napari; several paths are not read as one.
    """
    if not isinstance(path, str):
        return None
    file = Path(path)
    if file.suffix.lower() in CALIBRATION.suffixes:
        return read_calibration_file if is_calibration(file) else None
    return read_recording


def read_recording(path: str | Sequence[str]) -> list[tuple[Any, ...]]:
    """Open the recording at `path` as lazy layers, with the calibration beside it, in it, or the active one."""
    try:
        opened = open_layers(str(path), settings.active_calibration())
    except ElsPlusError as error:
        show_error(str(error))
        return NO_LAYERS
    for note in opened.notes:
        show_warning(note)
    return [tuple(layer) for layer in opened.layers]


def read_calibration_file(path: str | Sequence[str]) -> list[tuple[Any, ...]]:
    """Return the outlines of the calibration at `path`, and make it the active one for recordings opened later."""
    try:
        opened = calibration_layers(str(path))
    except ElsPlusError as error:
        show_error(str(error))
        return NO_LAYERS
    settings.set_active_calibration(str(path))
    for note in opened.notes:
        show_info(note)
    return [tuple(layer) for layer in opened.layers] or NO_LAYERS
