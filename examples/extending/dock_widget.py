"""A dock widget of another package: mean ELS+ signal of the live stream, or of the frames of a layer.

A module that is imported: running it as a script does nothing. It is declared in the manifest of that package (see
docs/extending-dock-widget.md), or added to a viewer from a script:
``viewer.window.add_dock_widget(MeanSignalPanel(viewer), name="Mean signal")``.
"""

from __future__ import annotations

import time
from collections import deque

import numpy as np
from magicgui.widgets import PushButton
from napari.layers import Image
from qtpy.QtCore import QTimer
from qtpy.QtWidgets import QLabel, QVBoxLayout

from napari_elsplus.errors import InputError
from napari_elsplus.widgets.shared import EnginePanel, button_row, notify_errors
from napari_elsplus.widgets.shared.plots import Curve, ThemedPlot

INTERVAL_MS = 100
POINTS = 300


class MeanSignalPanel(EnginePanel):
    """Plots the mean grey level of live ELS+ images over time, or of a layer (T, rows, cols) over its frames."""

    def __init__(self, viewer):
        super().__init__(viewer)
        self.live = deque(maxlen=POINTS)
        self.plot = ThemedPlot("time / s", "mean ELS+ / grey levels", viewer.theme)
        self.state = QLabel()
        self.measure = PushButton(text="Plot selected layer", tooltip="Mean of each frame of the selected image layer")
        self.measure.clicked.connect(self.plot_layer)
        layout = QVBoxLayout(self)
        layout.addWidget(self.plot, 1)
        layout.addWidget(self.state)
        layout.addLayout(button_row(self.measure))
        self.connect_signal(viewer.events.theme, lambda _: self.plot.apply_theme(viewer.theme))
        self._sequence, self._image = -1, np.zeros(0, np.float32)
        self._timer = QTimer(self)
        self._timer.setInterval(INTERVAL_MS)
        self._timer.timeout.connect(self.refresh)
        self._timer.start()
        self.refresh()

    def refresh(self):
        """Add the newest live image to the plot; called by the timer and after each answer of the engine."""
        client, calibration = self.connection.client, self.connection.calibration
        connected = "not connected" if client is None else f"rig {self.connection.rig}"
        scale = "no calibration" if calibration is None else f"{calibration.um_per_px} µm per pixel"
        self.state.setText(f"{connected}; {scale}")
        ring = client.display() if client is not None and client.status.live else None
        shapes = {} if ring is None else {name: shape for name, shape, _ in ring.layout.fields}
        if "els" not in shapes:
            return
        if self._image.shape != shapes["els"]:
            self._sequence, self._image = -1, np.zeros(shapes["els"], np.float32)
        stamp = ring.newest_after(self._sequence, {"els": self._image})
        if stamp is not None:
            self._sequence = stamp.sequence
            self.live.append((time.monotonic(), float(np.nanmean(self._image))))
            seconds, means = np.array(self.live).T
            self._draw(seconds - seconds[0], means, "time / s")

    def plot_layer(self):
        """Plot the mean of each frame of the selected layer; frames are read in a thread."""
        with notify_errors(self):
            layer = self.viewer.layers.selection.active
            if not isinstance(layer, Image) or layer.ndim != 3:
                raise InputError("no image layer (T, rows, cols) is selected", "select one, for instance ELS+")
            data = layer.data
            self.requests.run(
                lambda: np.array([float(np.mean(np.asarray(frame))) for frame in data]),
                lambda means: self._draw(np.arange(len(means)), means, "frame"),
            )

    def cleanup(self):
        """Stop the timer, then release engine and viewer."""
        self._timer.stop()
        super().cleanup()

    def _draw(self, x, means, bottom):
        self.plot.draw([Curve("mean", x, means, "green")], bottom=bottom)
