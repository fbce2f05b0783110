"""Base class of the analysis panels: a computation in a thread, numbers, a plot to save, and a script to copy."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from napari_elsplus._problems import notify_errors
from napari_elsplus.io.formats.registry import dialog_filter
from napari_elsplus.widgets.shared.files import choose_file_to_write
from napari_elsplus.widgets.shared.panel import Panel, push_button, text_label
from napari_elsplus.widgets.shared.plots import ThemedPlot
from napari_elsplus.widgets.shared.work import Work

if TYPE_CHECKING:
    import napari.viewer
    from magicgui.widgets import PushButton

    from napari_elsplus.io.formats.registry import FileFormat


class AnalysisPanel(Panel):
    """A panel that measures layers of the viewer.

    Parameters
    ----------
    viewer : napari.Viewer
        The viewer.
    bottom, left : str
        Labels of the plot's axes.
    """

    def __init__(self, viewer: napari.viewer.Viewer, bottom: str, left: str) -> None:
        super().__init__(viewer)
        self.work = Work(self._work_ended)
        self.numbers = text_label()
        self.plot = ThemedPlot(bottom, left, viewer.theme)
        self.script = push_button("Copy as script", self.copy_script)
        layers = viewer.layers.events
        for signal in (layers.inserted, layers.removed, layers.renamed):
            self.connect_signal(signal, self._layers_changed)
        self.connect_signal(viewer.events.theme, self._theme_changed)

    def copy_script(self) -> None:
        """Copy a script that makes this analysis to the clipboard."""
        raise NotImplementedError

    def save_to(self, path: str | Path) -> None:
        """Save the plot as a picture (``.png``) or a table (``.csv``) at a path."""
        self.plot.save(Path(path))

    def cleanup(self) -> None:
        """Cancel the computation and disconnect from the viewer."""
        self.work.cancel()
        super().cleanup()

    def save_button(self, text: str, title: str, name: str, *formats: FileFormat) -> PushButton:
        """Return a button that saves to a file which the user chooses.

        Parameters
        ----------
        text : str
            On the button.
        title, name : str
            Title of the dialog, and suggested file name.
        *formats : FileFormat
            Kinds of files.
        """

        def save(path: Path) -> None:
            with notify_errors(self):
                self.save_to(path)

        return push_button(text, lambda: choose_file_to_write(self, title, name, dialog_filter(*formats), save))

    def _layers_changed(self) -> None:
        """Update the choices and buttons."""
        raise NotImplementedError

    def _work_ended(self) -> None:
        self._layers_changed()

    def _theme_changed(self) -> None:
        self.plot.apply_theme(self.viewer.theme)
