"""The window with each panel at work on simulated data, as a user would see it."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any, Final

import napari
from qtpy.QtWidgets import QApplication

from napari_elsplus import _sample_data, _window
from napari_elsplus.acquisition.engine.status import Settings
from napari_elsplus.widgets.analysis.axial import SIMULATED

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from napari_elsplus.widgets.dock.panel import ElsPlusDock

FRAMES: Final = 96
"""Frames of the sample recording here; chosen: 0.4 s of motion are enough for a mosaic."""
TIMEOUT_S: Final = 240.0
"""Limit of one action, seconds; chosen: the first use compiles kernels."""
SETTLE_S: Final = 1.0
"""Time for layout and drawing before a picture, seconds; chosen."""
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

    def settle(self) -> None:
        """Process events until layout and drawing are done."""
        end_s = time.monotonic() + SETTLE_S
        self.wait(lambda: time.monotonic() > end_s)

    def panels(self) -> Iterator[str]:
        """Bring one panel after the other to the front, at work; yields its title."""
        panel: dict[str, Any] = {title: tab.panel for title, tab in self.dock.by_title.items()}
        yield from self._front("Compare", panel["Compare"].begin, lambda: panel["Compare"].comparing)
        panel["Compare"].end()
        quality = panel["Quality"]
        yield from self._front("Quality", quality.measure_edge, lambda: quality.edge is not None)
        axial = panel["Axial response"]
        axial.source.value = SIMULATED
        yield from self._front("Axial response", axial.simulate.native.click, lambda: bool(axial.scans))
        mosaic = panel["Mosaic"]
        yield from self._front("Mosaic", mosaic.begin, lambda: not mosaic.work.busy)
        mosaic.clear()
        connection = self.dock.connection
        panel["Rig"].rate_hz.value = PRESET.frame_rate_hz
        yield from self._front("Rig", panel["Rig"].toggle, lambda: connection.client is not None)
        live = panel["Live"]
        yield from self._front("Live", live.toggle, lambda: live.live and len(live.layers.images) > 1)
        live.toggle()
        self.wait(lambda: not live.live and not live.requests.busy)
        calibration = panel["Calibration"]
        calibration.choose("galvo")
        yield from self._front("Calibration", calibration.measure, lambda: calibration.candidate is not None)

    def close(self) -> None:
        """Close the window without questions about unsaved results."""
        for tab in self.dock.by_title.values():
            tab.cleanup()
        self.viewer.close()

    def _front(self, title: str, act: Callable[[], object], reached: Callable[[], bool]) -> Iterator[str]:
        self.dock.show_tab(title)
        act()
        self.wait(reached)
        self.settle()
        yield title
