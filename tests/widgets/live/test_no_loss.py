"""A stream of which no frame is lost, whatever its window does."""

from __future__ import annotations

import time

import numpy as np
import pytest

from napari_elsplus.io import open_recording

BLOCKED_FRAMES = 300
"""More than the engine keeps in memory, so that none is lost only if it does not wait for the window."""


@pytest.fixture
def viewer(small_engine, make_napari_viewer_proxy):
    return make_napari_viewer_proxy()


def test_a_blocked_window_loses_nothing(viewer, panel, qtbot, tmp_path):
    panel.form.start.native.click()
    qtbot.waitUntil(lambda: panel.live and panel.form.record.enabled, timeout=30_000)
    panel.form.record.native.click()
    status = lambda: panel.connection.client.status  # noqa: E731
    qtbot.waitUntil(lambda: status().recording is not None and status().recording.frames > 0, timeout=30_000)
    before, end_s = status().recording.frames, time.monotonic() + 60
    while status().recording.frames < before + BLOCKED_FRAMES:  # the window does nothing else
        assert time.monotonic() < end_s
        time.sleep(0.01)
    qtbot.wait(300)
    panel.form.record.native.click()
    qtbot.waitUntil(lambda: not status().recording.running, timeout=30_000)
    assert status().dropped == {}
    (path,) = tmp_path.glob("recording-*.ome.tif")
    with open_recording(path) as recording:
        assert len(recording) >= before + BLOCKED_FRAMES
        assert (np.diff(recording.frame_numbers) == 1).all()
