"""File dialogs of the panels, which begin in the folder where the user works."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

from qtpy.QtWidgets import QFileDialog

if TYPE_CHECKING:
    from collections.abc import Callable

    from qtpy.QtWidgets import QWidget

_last: Path | None = None


def note_folder(path: Path | None) -> None:
    """Begin the next dialog in the folder of a file, or in a folder, by its path; None changes nothing."""
    global _last
    if path is not None:
        _last = path if path.is_dir() else path.parent


def choose_file_to_write(parent: QWidget, title: str, name: str, kinds: str, act: Callable[[Path], object]) -> None:
    """Act on the file that the user chooses to write, if one was chosen.

    Parameters
    ----------
    parent : QWidget
        The panel.
    title : str
        Of the dialog.
    name : str
        Suggested name.
    kinds : str
        Filter of the dialog; a name without a suffix has that of the kind that is chosen there.
    act : callable
        Called with the path.
    """
    suggested = name if _last is None else str(_last / name)
    chosen, kind = QFileDialog.getSaveFileName(parent, title, suggested, kinds)
    endings = re.findall(r"\*(\.[\w.]+)", kind)
    if chosen and endings and not Path(chosen).suffix:
        chosen += endings[0]
        if Path(chosen).exists():  # the dialog, again, asks before it is replaced
            note_folder(Path(chosen))
            choose_file_to_write(parent, title, Path(chosen).name, kinds, act)
            return
    _act(chosen, act)


def choose_file_to_read(parent: QWidget, title: str, kinds: str, act: Callable[[Path], object]) -> None:
    """Act on the file that the user chooses to read, if any; parameters as of :func:`choose_file_to_write`."""
    _act(QFileDialog.getOpenFileName(parent, title, _start(), kinds)[0], act)


def choose_folder(parent: QWidget, title: str, act: Callable[[Path], object]) -> None:
    """Act on the folder that the user chooses, if one was chosen; parameters as of :func:`choose_file_to_write`."""
    _act(QFileDialog.getExistingDirectory(parent, title, _start()), act)


def _start() -> str:
    return "" if _last is None else str(_last)


def _act(chosen: str, act: Callable[[Path], object]) -> None:
    if chosen:
        note_folder(Path(chosen))
        act(Path(chosen))
