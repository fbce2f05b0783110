"""The window with each panel at work on simulated data, as a user would see it."""

from __future__ import annotations

import time
from tempfile import gettempdir
from typing import TYPE_CHECKING, Any, Final

import napari
import numpy as np
from qtpy.QtWidgets import QApplication

from napari_elsplus import _sample_data, _window
from napari_elsplus.acquisition.engine.status import Settings
from napari_elsplus.io.settings import remember
from napari_elsplus.widgets.analysis.axial import SIMULATED
from napari_elsplus.widgets.analysis.compare import DIFFERENCE
from napari_elsplus.widgets.analysis.quality import EDGE

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from napari_elsplus.widgets.dock.panel import ElsPlusDock

FRAMES: Final = 96
"""Frames of the sample recording here; chosen: 0.4 s of motion are enough for a mosaic."""
TIMEOUT_S: Final = 240.0
"""Limit of one action, seconds; chosen: the first use compiles kernels."""
SETTLE_S: Final = 1.0
"""Time for layout and drawing before a picture, seconds; chosen."""
FILLED: Final = 0.9
"""Share of the canvas that the images fill; chosen."""
PRESET: Final = Settings("240hz", frame_rate_hz=60.0)
"""A rate that a computer without a graphics card can display."""


class Scene:
    """A window with the ELS+ dock and the sample recording.

    Parameters
    ----------
    size : tuple of int
        Width and height of the window, pixels.
    """

    def __init__(self, size: tuple[int, int]) -> None:
        remember("rig", heartbeat_timeout_s=TIMEOUT_S)  # windows drawn by software may be slow
        frames, _sample_data.FRAMES = _sample_data.FRAMES, FRAMES  # type: ignore[misc]
        self.viewer = napari.Viewer()
        self.viewer.window.resize(*size)
        _window.fill(self.viewer)
        _sample_data.FRAMES = frames  # type: ignore[misc]
        self.dock: ElsPlusDock = next(iter(self.viewer.window.dock_widgets.values()))
        self.wait(lambda: all(tab.built for tab in self.dock.by_title.values()))
        self.settle()

    def wait(self, condition: Callable[[], bool], timeout_s: float = TIMEOUT_S) -> None:
        """Process the window's events until a condition holds; raise `TimeoutError` if it never does.

        Parameters
        ----------
        condition : callable
            Tested between events.
        timeout_s : float
            Limit, seconds.
        """
        end_s = time.monotonic() + timeout_s
        while not condition():
            if time.monotonic() > end_s:
                raise TimeoutError("the window did not reach the state that was to be drawn")
            QApplication.processEvents()
            time.sleep(0.01)

    def settle(self, seconds: float = SETTLE_S) -> None:
        """Process events for some `seconds`, until layout and drawing are done."""
        end_s = time.monotonic() + seconds
        self.wait(lambda: time.monotonic() > end_s)

    def panels(self) -> Iterator[str]:
        """Bring one panel after the other to the front, at work; yields its title, and what it displays."""
        panel: dict[str, Any] = {title: tab.panel for title, tab in self.dock.by_title.items()}
        yield "Start"
        compare = panel["Compare"]
        yield from self._front("Compare", compare.begin, lambda: compare.comparing)
        compare.view.value = DIFFERENCE
        yield from self._front("Compare", lambda: None, lambda: not compare.work.busy, "difference")
        compare.end()
        quality = panel["Quality"]
        yield from self._front("Quality", quality.measure_edge, lambda: quality.edge is not None)
        self.viewer.layers.remove(EDGE)
        axial = panel["Axial response"]
        axial.source.value = SIMULATED
        yield from self._front("Axial response", axial.simulate.native.click, lambda: bool(axial.scans))
        mosaic = panel["Mosaic"]
        for box in mosaic.form.modes.values():
            box.value = True
        yield from self._front("Mosaic", mosaic.begin, lambda: not mosaic.work.busy and not mosaic.layers.behind)
        mosaic.clear()
        connection = self.dock.connection
        panel["Rig"].rate_hz.value = PRESET.frame_rate_hz
        yield from self._front("Rig", panel["Rig"].toggle, lambda: connection.client is not None)
        live = panel["Live"]
        live.form.folder.value = gettempdir()
        yield from self._front("Live", live.toggle, lambda: live.live and len(live.layers.images) > 1)
        live.toggle()
        self.wait(lambda: not live.live and not live.requests.busy)
        calibration = panel["Calibration"]
        for step, measure in (
            ("galvo", calibration.measure), ("offset", calibration.follow_offset), ("pair", calibration.measure),
        ):  # fmt: skip
            calibration.choose(step)
            if step == "pair":  # its image and outlines alone
                for layer in self.viewer.layers:
                    layer.visible = False
            yield from self._front("Calibration", measure, lambda: calibration.candidate is not None, step)
            if step == "offset":
                calibration.follow_offset()
                self.wait(lambda: not calibration.work.busy)

    def close(self) -> None:
        """Close the window without questions about unsaved results."""
        for tab in self.dock.by_title.values():
            tab.cleanup()
        self.viewer.close()

    def fit(self) -> None:
        """Fit the visible layers into the canvas."""
        extents = [_drawn(one) for one in self.viewer.layers if one.visible]
        first, last = np.min([one[0] for one in extents], axis=0), np.max([one[1] for one in extents], axis=0)
        camera, canvas = self.viewer.scene.camera, np.array(self.viewer.canvas.size)
        camera.center = tuple((first + last) / 2)
        camera.zoom = FILLED * float((canvas / (last - first)).min())

    def _front(
        self, title: str, act: Callable[[], object], reached: Callable[[], bool], part: str = ""
    ) -> Iterator[str]:
        self.dock.show_tab(title)
        act()
        self.wait(reached)
        self.settle()
        yield f"{title} {part}".strip()


def _drawn(layer: Any) -> np.ndarray[Any, Any]:
    """Return the first and last (row, col) of a layer in the world: of a mosaic, of the part that is drawn."""
    extent: np.ndarray[Any, Any] = np.asarray(layer.extent.world)[:, -2:]
    if getattr(layer, "multiscale", False) and np.isfinite(layer.data[-1]).any():
        drawn = np.argwhere(np.isfinite(layer.data[-1])) / layer.data[-1].shape
        extent = extent[0] + np.array([drawn.min(axis=0), drawn.max(axis=0)]) * (extent[1] - extent[0])
    return extent
