"""Expected errors: a notification each, and the newest one remembered until it is resolved, for the status line."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING

from napari.utils.notifications import show_error

from napari_elsplus.errors import ElsPlusError, error_message

if TYPE_CHECKING:
    from collections.abc import Iterator

    from qtpy.QtWidgets import QWidget


class Problems:
    """The unresolved error of each panel; a later action of the panel that succeeds resolves it.

    Notifications are cut after some words, and fade.
    """

    def __init__(self) -> None:
        self._messages: dict[int | None, str] = {}

    @property
    def newest(self) -> str:
        """Newest unresolved error with its remedy; empty if there is none."""
        return next(reversed(self._messages.values()), "")

    def report(self, message: str, panel: QWidget | None = None) -> None:
        """Show a message as a notification and remember it; one that another panel has shown is not shown twice.

        Parameters
        ----------
        message : str
            The problem and its remedy.
        panel : QWidget, optional
            The panel whose action failed.
        """
        shown = message in self._messages.values()
        self.remember(message, panel)
        if not shown:
            show_error(message)

    def remember(self, message: str, panel: QWidget | None = None) -> None:
        """Remember a message that napari itself shows; parameters as of :meth:`report`."""
        self.resolve(panel)  # to the end of the order
        self._messages[None if panel is None else id(panel)] = message

    def resolve(self, panel: QWidget | None = None) -> None:
        """Forget the error of a panel, after an action that succeeded or when it is removed.

        Parameters
        ----------
        panel : QWidget, optional
            The panel.
        """
        self._messages.pop(None if panel is None else id(panel), None)

    def dismiss(self) -> None:
        """Forget all errors: the user has read them."""
        self._messages.clear()


problems = Problems()
"""Of this process."""


@contextmanager
def notify_errors(panel: QWidget | None = None, *, resolves: bool = True) -> Iterator[None]:
    """Return a context that shows an expected error as one notification, with its remedy.

    Parameters
    ----------
    panel : QWidget, optional
        The panel whose action this is: the status line keeps the error until an action of the panel succeeds.
    resolves : bool
        Success resolves the panel's error; not where this is no action of the user.
    """
    try:
        yield
    except (ElsPlusError, OSError) as error:
        problems.report(error_message(error), panel)
    else:
        if resolves:
            problems.resolve(panel)
