"""Layers that a panel can process, and the index of the displayed frame."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from magicgui.widgets import ComboBox
from napari.layers import Image

from napari_elsplus.acquisition.engine.live_images import RAW
from napari_elsplus.errors import InputError
from napari_elsplus.viewing.provenance import provenance_of

LIVE: Final = "live"
"""Prefix of the metadata kind of layers that show live images."""
SAMPLE: Final = "a sample: File > Open Sample > ELS+ endomicroscopy"

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    import napari.viewer
    from napari.layers import Layer
    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.viewing.stack import Stack


class LayerChoice(ComboBox):
    """Choice of a layer by its name, which follows the layer when it is renamed.

    Parameters
    ----------
    viewer : napari.Viewer
        The viewer that has the layers.
    offered : callable
        Returns the names of the viewer's layers that can be chosen.
    label, tooltip : str
        Beside the choice, and over it.
    """

    def __init__(
        self,
        viewer: napari.viewer.Viewer,
        offered: Callable[[napari.viewer.Viewer], list[str]],
        label: str,
        tooltip: str,
    ) -> None:
        self._viewer = viewer
        self._layer: Layer | None = None
        super().__init__(label=label, choices=lambda _: offered(viewer), tooltip=tooltip)
        self._known: list[Layer] = []
        self._note_layer()
        self.changed.connect(self._note_layer)

    @property
    def layer(self) -> Layer | None:
        """The chosen layer."""
        return self._layer

    @property
    def remedy(self) -> str:
        """What the user has to do where no recording with a calibration can be chosen."""
        bare = [layer.name for layer in self._viewer.layers if is_uncalibrated(layer)]
        if not bare:
            return f"open a recording with a calibration, or {SAMPLE}"
        return (
            f"give {bare[-1]} a calibration: make and save one in Calibration, or drop its file on napari, then open "
            f"the recording again; or open {SAMPLE}"
        )

    def refresh(self, *, newest: bool = False) -> None:
        """Update the entries without a changed signal; a layer that is still offered stays chosen, by whatever name.

        Parameters
        ----------
        newest : bool
            Choose frames with a calibration that came since: of a recording that was opened, or of the stream.
        """
        with self.changed.blocked():
            self.reset_choices()
            offered = [self._viewer.layers[name] for name in calibrated_frames(self._viewer) if name in self.choices]
            opened = [layer for layer in offered if layer not in self._known]
            self._known = offered
            layer = opened[-1] if newest and opened else self._layer
            if layer is None or not self.select(layer):
                self._note_layer()

    def select(self, layer: Layer) -> bool:
        """Choose a `layer` without a changed signal; return False if it is not offered."""
        offered = layer in self._viewer.layers and layer.name in self.choices
        if offered:
            with self.changed.blocked():
                self.value, self._layer = layer.name, layer
        return offered

    def _note_layer(self) -> None:
        chosen = (layer for layer in self._viewer.layers if layer.name == self.value)
        self._layer = next(chosen, None)


def calibrated_recordings(viewer: napari.viewer.Viewer) -> list[str]:
    """Return the names of the raw layers of a viewer that have a calibration."""
    return _calibrated(viewer, RAW)


def calibrated_frames(viewer: napari.viewer.Viewer) -> list[str]:
    """Return the names of a viewer's layers of raw frames with a calibration: recordings, and the live frame."""
    return [*_calibrated(viewer, RAW), *_calibrated(viewer, f"{LIVE} {RAW}")]


def _calibrated(viewer: napari.viewer.Viewer, kind: str) -> list[str]:
    noted = {layer.name: provenance_of(layer.metadata) for layer in viewer.layers}
    return [name for name, facts in noted.items() if facts.get("kind") == kind and facts.get("calibration")]


def is_raw(layer: Layer) -> bool:
    """Return True for a layer that was opened as raw frames."""
    return provenance_of(layer.metadata).get("kind") == RAW


def is_uncalibrated(layer: Layer | None) -> bool:
    """Return True for a layer that was opened as raw frames, and has no calibration."""
    return layer is not None and is_raw(layer) and not provenance_of(layer.metadata).get("calibration")


def shown_index(viewer: napari.viewer.Viewer, layer: Image) -> int:
    """Return the index of the plane of a layer that the viewer displays.

    Parameters
    ----------
    viewer : napari.Viewer
        Its first slider counts.
    layer : napari.layers.Image
        (T, rows, cols). The nearest plane where the slider lies outside the layer.
    """
    steps = (viewer.dims.point[0] - layer.translate[0]) / layer.scale[0]
    return int(np.clip(round(steps), 0, layer.data.shape[0] - 1))


def chosen_image(choice: LayerChoice, what: str) -> Image:
    """Return the selected layer.

    Parameters
    ----------
    choice : LayerChoice
        In which it is selected.
    what : str
        What the layer is, for the message.

    Raises
    ------
    InputError
        If nothing is selected.
    """
    layer = choice.layer
    if layer is None:
        raise InputError(f"no {what} is open", "open one, or File > Open Sample > ELS+ endomicroscopy")
    assert isinstance(layer, Image)
    return layer


class ChosenRecording(NamedTuple):
    """A layer of a recording: its raw frames, their calibration, and the file of that."""

    layer: Image
    stack: Stack
    calibration: Calibration
    calibration_path: Path | None


def chosen_recording(choice: LayerChoice, what: str = "recording with a calibration") -> ChosenRecording:
    """Return the selected recording with its calibration; parameters and errors as of :func:`chosen_image`."""
    layer = chosen_image(choice, what)
    facts = provenance_of(layer.metadata)
    return ChosenRecording(layer, facts["stack"], facts["calibration"], facts["calibration_path"])


def frames_of(layer: Layer | None) -> tuple[Stack, NDArray[np.floating] | None]:
    """Return the raw frames of a layer, and the voltages of a sweep where it contains them.

    Parameters
    ----------
    layer : napari.layers.Layer or None
        The selected layer.

    Raises
    ------
    InputError
        If it is not a layer of raw frames.
    """
    facts = {} if layer is None else provenance_of(layer.metadata)
    if facts.get("kind") != RAW or facts.get("stack") is None:
        name = "no layer is selected" if layer is None else f"{layer.name} is no layer of raw frames"
        raise InputError(name, "select one; File > Open Sample > ELS+ endomicroscopy has a calibration set")
    return facts["stack"], facts.get("volts")
