"""Display rate of live images: ``python -m benchmarks.rigs.display_rate --seconds S --canvas PX [PX ...]``.

A window of its own with the Live panel, the engine in its process, the simulated rig at 240 Hz; one layer, then two, up
to five, on a canvas of each size. Prints a line of JSON for each.
"""

from __future__ import annotations

import json
import sys
import time
from argparse import ArgumentParser
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Final

import napari
import numpy as np
from qtpy.QtCore import QEventLoop, Qt, QTimer
from qtpy.QtTest import QTest
from qtpy.QtWidgets import QApplication, QDockWidget, QOpenGLWidget  # type: ignore[attr-defined] # where Qt 6 has it

from benchmarks.rigs.engines import perfect_calibration
from napari_elsplus._problems import problems
from napari_elsplus.acquisition.engine.status import Settings
from napari_elsplus.hardware.rig import SIMULATED
from napari_elsplus.widgets.live.panel import TICK_MS, LivePanel

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from napari_elsplus.acquisition.link.client import EngineClient
    from napari_elsplus.widgets.shared.connection import Connection

PRESET: Final = "240hz"
SETTLE_S: Final = 1.0
MOUSE: Final[Any] = QTest
"""Its stubs declare static functions as methods."""
_PATIENCE_S: Final = 60.0


@dataclass(frozen=True)
class Rate:
    """With so many layers.

    Parameters
    ----------
    layers : int
        Shown side by side.
    wanted_px : int
        Height and width that the canvas should have.
    canvas_px : tuple of int
        Height and width that it has.
    display_hz, drawn_hz : float
        Images given to the layers, and drawings of the canvas, each second.
    update_ms : float
        Median time in which the newest images are copied into the layers and the layers told.
    window_ms : float
        Processor time of the window's thread for each image given: update, drawing, and all else.
    camera_hz : float
        Frames of the camera each second.
    latency_p99_ms : float
        Of the engine, since the stream began.
    lost : int
        Frames lost since the stream began.
    tick_p99_ms : float
        99 % of the intervals between two events of a timer of `TICK_MS` in the window's thread are shorter.
    stop_s : float
        From a click on Stop until the panel displays that the stream has stopped.
    """

    layers: int
    wanted_px: int
    canvas_px: tuple[int, int]
    display_hz: float
    drawn_hz: float
    update_ms: float
    window_ms: float
    camera_hz: float
    latency_p99_ms: float
    lost: int
    tick_p99_ms: float
    stop_s: float


def measure(seconds: float, canvases_px: Sequence[int], most: int) -> None:
    """Show up to so many layers on canvases of several sizes, each number of them for some seconds."""
    viewer = napari.Viewer(show=False)
    viewer.show(block=False)
    panel = LivePanel(viewer)
    viewer.window.add_dock_widget(panel, name="Live")
    try:
        panel.connection.apply(perfect_calibration(PRESET))
        panel.requests.run(lambda: _connected(panel.connection), lambda _: panel.toggle())  # in a thread
        _until("the stream was live", lambda: panel.live)
        client = panel.connection.require()
        for wanted_px in canvases_px:
            _give_the_canvas(panel, wanted_px)
            for layers in range(1, most + 1):
                rate = _measure(panel, client, layers, wanted_px, seconds)
                sys.stdout.write(json.dumps(asdict(rate)) + "\n")
                sys.stdout.flush()
    finally:
        panel.cleanup()
        viewer.close()


def _measure(panel: LivePanel, client: EngineClient, layers: int, wanted_px: int, seconds: float) -> Rate:
    for place, box in enumerate(reversed(panel.form.kinds.values())):  # ELSA, ELS+, residual, LS, raw
        box.value = place < layers
    _until(
        f"{layers} layers were visible",
        lambda: sum(layer.visible for layer in panel.layers.images.values()) == layers,
    )
    panel.viewer.reset_view()
    took_s: list[float] = []
    update = panel.layers.update

    def timed(*arguments: object, **options: object) -> object:
        begin_s = time.perf_counter()
        shown = update(*arguments, **options)  # type: ignore[arg-type] # passed on
        if shown is not None:
            took_s.append(time.perf_counter() - begin_s)
        return shown

    _go_on(SETTLE_S)
    ticks_s: list[float] = []
    timer = QTimer()
    timer.timeout.connect(lambda: ticks_s.append(time.perf_counter()))
    timer.start(TICK_MS)
    panel.layers.update = timed  # type: ignore[method-assign,assignment] # while it is measured
    drawn, begin_s, spent_s = panel.canvas.drawn, time.perf_counter(), time.thread_time()
    _go_on(seconds)
    measured_s, spent_s = time.perf_counter() - begin_s, time.thread_time() - spent_s
    timer.stop()
    panel.layers.update = update  # type: ignore[method-assign]
    status = client.status
    return Rate(
        layers,
        wanted_px,
        panel.canvas.canvas_px,
        len(took_s) / measured_s,
        (panel.canvas.drawn - drawn) / measured_s,
        1e3 * float(np.median(took_s)),
        1e3 * spent_s / len(took_s),
        status.camera_hz,
        status.latency_ms.p99,
        sum(status.dropped.values()),
        1e3 * float(np.quantile(np.diff(ticks_s), 0.99)),
        _stop(panel),
    )


def _stop(panel: LivePanel) -> float:
    """Press Stop, and return the seconds until the panel displays it; then start again."""
    button: Any = panel.form.start.native
    begin_s = time.perf_counter()
    MOUSE.mouseClick(button, Qt.MouseButton.LeftButton)
    _until("Stop was displayed", lambda: button.text() == "Start")
    stopped_s = time.perf_counter() - begin_s
    _until("the engine had stopped", lambda: not panel.requests.busy and panel.form.start.enabled)
    MOUSE.mouseClick(button, Qt.MouseButton.LeftButton)
    _until("the stream was live again", lambda: panel.live)
    _go_on(SETTLE_S)
    return stopped_s


def _give_the_canvas(panel: LivePanel, size_px: int) -> None:
    """Let all docks but the panel's go, float that, and give the window the size with which the canvas has its own."""
    dock = panel.parentWidget()
    while not isinstance(dock, QDockWidget):
        assert dock is not None
        dock = dock.parentWidget()
    window = dock.parentWidget()
    assert window is not None
    for other in window.findChildren(QDockWidget):
        other.setVisible(other is dock)
    dock.setFloating(True)
    canvas = window.findChildren(QOpenGLWidget)[0]
    for _ in range(3):  # the layout follows a moment later
        _go_on(0.2)
        window.resize(window.width() + size_px - canvas.width(), window.height() + size_px - canvas.height())


def _connected(connection: Connection) -> None:
    client = connection.connect(SIMULATED, Settings(PRESET))
    client.set_heartbeat_timeout(_PATIENCE_S).result()  # a window's first images take seconds on a busy machine


def _until(what: str, condition: Callable[[], bool]) -> None:
    """Process the window's events until a condition holds; an error that a panel reports ends the program."""
    end_s = time.perf_counter() + _PATIENCE_S
    while not condition():
        if problems.newest:
            raise RuntimeError(f"before {what}: {problems.newest}")
        if time.perf_counter() > end_s:
            raise TimeoutError(f"{_PATIENCE_S:g} s passed before {what}")
        _go_on(0.005)


def _go_on(seconds: float) -> None:
    """Let the window live for some time."""
    end_s = time.perf_counter() + seconds
    while (left_s := end_s - time.perf_counter()) > 0:
        QApplication.processEvents(QEventLoop.ProcessEventsFlag.WaitForMoreEvents, max(1, int(1e3 * left_s)))


if __name__ == "__main__":
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--canvas", type=int, nargs="+", default=[600], help="height and width of the canvas, about")
    parser.add_argument("--layers", type=int, default=5, help="the most that are shown")
    given = parser.parse_args()
    measure(given.seconds, given.canvas, given.layers)
