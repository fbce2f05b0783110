"""The napari reader: recordings of any registered format, and calibration files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from napari.utils.notifications import show_info, show_warning

from napari_elsplus._problems import notify_errors, problems
from napari_elsplus._view import answer_during, open_in_viewer, prepare_shapes, read_units
from napari_elsplus.errors import InputError
from napari_elsplus.io import settings
from napari_elsplus.io.calibration_lookup import is_calibration
from napari_elsplus.io.formats.registry import CALIBRATION, foreign_file
from napari_elsplus.io.formats.tiff_folder import TiffFolder
from napari_elsplus.viewing.layers import open_layers
from napari_elsplus.viewing.outlines import calibration_layers

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    Reader = Callable[[str | Sequence[str]], list[tuple[Any, ...]]]

NO_LAYERS: Final[list[tuple[Any, ...]]] = [(None,)]
"""By napari's convention: the file was read, and there is no layer to add."""


def get_reader(path: str | Sequence[str]) -> Reader:
    """Return the function that reads a path to layers, or several paths to those of one recording.

    Parameters
    ----------
    path : str or sequence of str
        Dropped on napari; several to be opened as one stack.
    """
    if not isinstance(path, str):
        return read_frame_files
    file = Path(path)
    if file.suffix.lower() in CALIBRATION.suffixes:
        return read_calibration_file if is_calibration(file) else refuse_file
    return read_recording


def refuse_file(path: str | Sequence[str]) -> list[tuple[Any, ...]]:
    """Report that the file at `path` is none of ours: where no reader takes a file, napari prints a traceback."""
    problems.report(str(foreign_file(Path(str(path)))))
    return NO_LAYERS


def read_frame_files(path: str | Sequence[str]) -> list[tuple[Any, ...]]:
    """Open the files at several paths, one frame each, as the recording of their folder, or report what is missing."""
    files = {Path(one) for one in path}
    folder, whole = min(files).parent, False
    with notify_errors():
        whole = set(TiffFolder(folder).files) == files
        if not whole:
            raise InputError(
                f"these {len(files)} files are not all TIFFs of one folder",
                "open the folder itself; files of a recording each are opened without stacking them",
            )
    return read_recording(str(folder)) if whole else NO_LAYERS


def read_recording(path: str | Sequence[str]) -> list[tuple[Any, ...]]:
    """Open the recording at `path` as lazy layers, with the calibration beside it, in it, or the active one."""
    layers: list[tuple[Any, ...]] = []
    with notify_errors():
        opened = open_layers(str(path), settings.active_calibration())
        for note in opened.notes:
            show_warning(note)
        layers += open_in_viewer(opened.layers)
    return layers or NO_LAYERS


def read_calibration_file(path: str | Sequence[str]) -> list[tuple[Any, ...]]:
    """Return the outlines of the calibration at `path`, and make it the active one for recordings opened later."""
    layers: list[tuple[Any, ...]] = []
    with notify_errors():
        opened = calibration_layers(str(path))
        settings.set_active_calibration(str(path))
        for note in opened.notes:
            show_info(note)
        if opened.layers:
            read_units()
            answer_during(prepare_shapes)
        layers += [tuple(layer) for layer in opened.layers]
    return layers or NO_LAYERS
