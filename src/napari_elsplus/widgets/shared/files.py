"""File dialogs of the panels, which begin in the folder where the user works."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from qtpy.QtWidgets import QFileDialog

if TYPE_CHECKING:
    from qtpy.QtWidgets import QWidget

_last: Path | None = None


def note_folder(path: Path | None) -> None:
    """Begin the next dialog in the folder of a file, or in a folder, by its path; None changes nothing."""
    global _last
    if path is not None:
        _last = path if path.is_dir() else path.parent


def file_to_save(parent: QWidget, title: str, name: str, kinds: str) -> str:
    """Return the file that the user chooses to write; empty if none was chosen.

    Parameters
    ----------
    parent : QWidget
        The panel.
    title : str
        Of the dialog.
    name : str
        Suggested name.
    kinds : str
        Filter of the dialog.
    """
    suggested = name if _last is None else str(_last / name)
    return _noted(QFileDialog.getSaveFileName(parent, title, suggested, kinds)[0])


def file_to_open(parent: QWidget, title: str, kinds: str) -> str:
    """Return the file that the user chooses to read; empty if none was chosen.

    Parameters
    ----------
    parent : QWidget
        The panel.
    title : str
        Of the dialog.
    kinds : str
        Filter of the dialog.
    """
    return _noted(QFileDialog.getOpenFileName(parent, title, "" if _last is None else str(_last), kinds)[0])


def folder_to_open(parent: QWidget, title: str) -> str:
    """Return the folder that the user chooses; empty if none was chosen.

    Parameters
    ----------
    parent : QWidget
        The panel.
    title : str
        Of the dialog.
    """
    return _noted(QFileDialog.getExistingDirectory(parent, title, "" if _last is None else str(_last)))


def _noted(path: str) -> str:
    if path:
        note_folder(Path(path))
    return path
