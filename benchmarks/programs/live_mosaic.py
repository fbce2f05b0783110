"""The live mosaic in napari, on the simulated rig: frames lost, latency from camera to track, how often it is shown.

``python3 run.py bench live-mosaic``, without a screen under ``xvfb-run -a``. It opens napari with the Mosaic panel,
presses *Live mosaic* and looks on; with ``--live`` the Live panel shows LS and ELS+ beside it.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import click
import napari
import numpy as np
from qtpy.QtWidgets import QApplication

from benchmarks.harness.machine import machine
from napari_elsplus.processing.tracking.motion.pose import TrackingState
from napari_elsplus.widgets.shared.window import closing

if TYPE_CHECKING:
    from collections.abc import Callable

PLUGIN = "napari-elsplus"
START_S = 240.0
SETTLE_S = 3.0


def go_on(until: Callable[[], bool], seconds: float) -> bool:
    """Let napari work until something is so; whether it came to be."""
    end = time.perf_counter() + seconds
    while not until() and time.perf_counter() < end:
        QApplication.processEvents()
        time.sleep(0.001)
    return until()


@click.command()
@click.option("--seconds", default=60.0)
@click.option("--live", is_flag=True, help="The Live panel beside it.")
@click.option("--mode", "modes", multiple=True, default=("els",), help="Images that are laid; again for more.")
def live_mosaic(seconds: float, live: bool, modes: tuple[str, ...]) -> None:
    """Lay a mosaic live in a window: frames lost, lateness, and how often it is shown."""
    closing.confirm = lambda *_: True  # nobody is there to be asked whether the mosaic may go
    viewer = napari.Viewer()
    viewer.window.resize(1280, 900)
    if live:
        viewer.window.add_plugin_dock_widget(PLUGIN, "Live", tabify=True)
    _, panel = viewer.window.add_plugin_dock_widget(PLUGIN, "Mosaic", tabify=True)
    for mode, box in panel.form.modes.items():
        box.value = mode.value in modes
    shown: list[float] = []
    update = panel.layers.update

    def counted(*, whole: bool) -> bool:
        fresh: bool = update(whole=whole)
        if fresh:
            shown.append(time.perf_counter())
        return fresh

    panel.layers.update = counted
    panel.form.going_live.native.click()
    if not go_on(lambda: panel.live and len(shown) > 3, START_S):
        raise SystemExit("the live mosaic did not begin")
    go_on(lambda: False, SETTLE_S)
    client = panel.connection.client
    first, lost, begun = client.status.acquired, dict(client.status.dropped), time.perf_counter()
    shown.clear()
    go_on(lambda: False, seconds)
    status, took = client.status, time.perf_counter() - begun
    gaps = np.diff(shown)
    counts = status.track.counts
    latency = status.latency_ms
    click.echo(machine())
    click.echo(
        f"{status.acquired - first} frames in {took:.0f} s, {status.camera_hz:.0f} Hz; "
        f"lost {sum(status.dropped.values())} ({sum(lost.values())} before), "
        f"faults: {'; '.join(map(str, status.faults)) or 'none'}\n"
        f"camera to track: median {latency.p50:.1f} ms, 99 % {latency.p99:.1f} ms, longest {latency.max:.1f} ms\n"
        f"shown {len(shown) / took:.1f} times a second, 99 % of the gaps below {1e3 * np.quantile(gaps, 0.99):.0f} ms\n"
        f"{', '.join(f'{counts.get(state.value, 0)} {state.value}' for state in TrackingState)}; "
        f"{status.track.loop_closures} loop closures"
    )
    viewer.close()
    QApplication.processEvents()
