"""``napari-elsplus`` without a command: napari with the plugin, or one line with the reason why no window opens."""

from __future__ import annotations

import runpy

from napari_elsplus.diagnosis.machine import WITHOUT_SCREEN, probe_screen
from napari_elsplus.errors import DeviceError


def open_window() -> None:
    """Open napari with the plugin docked and stay until it is closed.

    Raises
    ------
    DeviceError
        If no screen answers.
    """
    screen = probe_screen()
    if not screen.answers:
        raise DeviceError(f"no window can be opened ({screen.detail})", WITHOUT_SCREEN)
    runpy.run_module("napari_elsplus._window", run_name="__main__")
