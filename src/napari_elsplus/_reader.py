"""napari's door for reading: recordings and calibration files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from napari.utils.notifications import show_error, show_info, show_warning

from napari_elsplus.errors import ElsPlusError
from napari_elsplus.instrument.calibration import FORMAT
from napari_elsplus.io import settings
from napari_elsplus.viewing.layers import open_layers
from napari_elsplus.viewing.outlines import calibration_layers

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    Reader = Callable[[str | Sequence[str]], list[tuple[Any, ...]]]

NO_LAYERS: Final[list[tuple[Any, ...]]] = [(None,)]
"""What napari takes for "read, and there is nothing to add"."""
_HEAD: Final = 1 << 16


def get_reader(path: str | Sequence[str]) -> Reader | None:
    """Return the function that reads a path, or None if it is no recording and no calibration.

    Parameters
    ----------
    path : str or sequence of str
        What was dropped on napari.

    Returns
    -------
    callable or None
        Path to layers.
    """
    if not isinstance(path, str):
        return None
    file = Path(path)
    if file.suffix.lower() == ".json":
        return read_calibration_file if _is_calibration(file) else None
    return read_recording


def read_recording(path: str | Sequence[str]) -> list[tuple[Any, ...]]:
    """Open a recording as lazy layers, with the calibration in it, beside it, or in force."""
    try:
        opened = open_layers(str(path), settings.active_calibration())
    except ElsPlusError as error:
        show_error(str(error))
        return NO_LAYERS
    for note in opened.notes:
        show_warning(note)
    return [tuple(layer) for layer in opened.layers]


def read_calibration_file(path: str | Sequence[str]) -> list[tuple[Any, ...]]:
    """Show a calibration's outlines and put it in force for recordings that are opened later."""
    try:
        opened = calibration_layers(str(path))
    except ElsPlusError as error:
        show_error(str(error))
        return NO_LAYERS
    settings.set_active_calibration(str(path))
    for note in opened.notes:
        show_info(note)
    return [tuple(layer) for layer in opened.layers] or NO_LAYERS


def _is_calibration(path: Path) -> bool:
    try:
        with path.open("rb") as file:
            return FORMAT.encode() in file.read(_HEAD)
    except OSError:
        return False
