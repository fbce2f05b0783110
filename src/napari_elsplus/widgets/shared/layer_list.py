"""The viewer's list of layers, left alone while only the pixels of images change.

napari tells its list of every event of a layer, and the list then paints all its rows anew: where that is done in
software it takes longer than giving the layers their images.
"""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING

from qtpy.QtWidgets import QListView

if TYPE_CHECKING:
    from collections.abc import Iterator

    from qtpy.QtCore import QAbstractItemModel
    from qtpy.QtWidgets import QWidget


class LayerList:
    """The lists in the window of a docked panel.

    Parameters
    ----------
    panel : QWidget
        The panel.
    """

    def __init__(self, panel: QWidget) -> None:
        self._panel = panel
        self._models: list[QAbstractItemModel] = []

    @contextmanager
    def undisturbed(self) -> Iterator[None]:
        """Let the list hear of no change meanwhile; layers may neither come nor go."""
        if not self._models:
            self._find()
        before = [(model, model.blockSignals(True)) for model in self._models]
        try:
            yield
        finally:
            for model, was_blocked in before:
                model.blockSignals(was_blocked)

    def _find(self) -> None:
        window = self._panel
        while (parent := window.parentWidget()) is not None:
            window = parent
        for view in window.findChildren(QListView):
            model = view.model()
            if model is not None:
                self._models.append(model)
                model.destroyed.connect(self._models.clear)
