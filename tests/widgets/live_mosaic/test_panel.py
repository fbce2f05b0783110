"""The Mosaic panel on the live stream, driven as a user drives it, with the engine in a process of its own."""

from __future__ import annotations

import os
import signal
from concurrent.futures import Future
from pathlib import Path

import numpy as np
import pytest

from napari_elsplus.viewing.mosaic.recorded import StackMosaics
from small_rig import small_calibration

PLUGIN = "napari-elsplus"


@pytest.mark.skipif(os.name != "posix", reason="kills as POSIX does")
def test_the_mosaic_of_a_killed_engine_stays_and_can_be_saved(viewer, panel, qtbot, go_live, tmp_path):
    go_live(viewer, panel, qtbot)
    os.kill(panel.connection.client.pid, signal.SIGKILL)
    qtbot.waitUntil(lambda: panel.connection.client is None, timeout=30_000)
    segments = lambda: list(Path("/dev/shm").glob(f"{panel._shown.board}*"))  # noqa: E731 - none but on Linux
    qtbot.waitUntil(lambda: not panel._shown.follows and not segments(), timeout=30_000)
    image = np.asarray(viewer.layers["mosaic LS"].data[0])
    assert np.nanmax(image) > 50
    panel.save(tmp_path / "kept.ome.tif")
    qtbot.waitUntil(lambda: (tmp_path / "kept.track.csv").exists() and not panel.work.busy, timeout=30_000)
    panel.undo()
    assert not np.isfinite(viewer.layers["mosaic LS"].data[0]).any()


def test_it_lies_beside_the_live_images_and_a_stack_is_not_disturbed_by_it(viewer, panel, qtbot, go_live):
    viewer.add_image(np.ones((400, 300)), name="live", scale=(2, 2))
    go_live(viewer, panel, qtbot)
    assert viewer.layers["live"].visible
    assert viewer.layers["mosaic LS"].extent.world[0, 1] > 600
    scene = np.random.default_rng(0).random((300, 300))
    viewer.add_image(np.stack([scene[k:][:200, :200] for k in range(6)]), name="mine", contrast_limits=(0, 1))
    panel.form.recording.value = "mine"
    panel.begin()
    qtbot.waitUntil(lambda: not panel.work.busy, timeout=60_000)
    qtbot.wait(300)
    assert isinstance(panel._shown, StackMosaics)
    assert "of 6 frames" in panel.form.status.text()


def test_images_side_by_side_make_room_for_the_live_panels(viewer, panel, qtbot, go_live):
    for mode, box in panel.form.modes.items():
        box.value = mode in ("ls", "elsa", "els")
    go_live(viewer, panel, qtbot)
    names = {"mosaic LS", "mosaic ELSA", "mosaic ELS+"}
    qtbot.waitUntil(lambda: names <= {layer.name for layer in viewer.layers}, timeout=30_000)
    qtbot.waitUntil(lambda: np.nan_to_num(viewer.layers["mosaic ELSA"].data[0]).max() > 1, timeout=30_000)
    viewer.window.add_plugin_dock_widget(PLUGIN, "Live")
    qtbot.waitUntil(lambda: "live LS" in viewer.layers, timeout=30_000)
    qtbot.waitUntil(
        lambda: viewer.layers["mosaic LS"].extent.world[0, 1] > viewer.layers["live LS"].extent.world[1, 1],
        timeout=30_000,
    )
    assert all(viewer.layers[name].visible for name in names)


def test_an_unsaved_live_mosaic_is_replaced_only_if_the_user_agrees(viewer, panel, qtbot, go_live, tmp_path, questions):
    go_live(viewer, panel, qtbot)
    assert questions == [], "there was no mosaic yet"
    first = panel._shown
    panel.save(tmp_path / "early.ome.tif")
    qtbot.waitUntil(lambda: not panel.work.busy and panel.form.going_live.enabled, timeout=30_000)
    rows = len(first.rows)
    qtbot.waitUntil(lambda: len(first.rows) > rows + 10, timeout=30_000)
    panel.form.going_live.native.click()
    qtbot.waitUntil(lambda: not panel.live and panel.form.going_live.text == "Live mosaic", timeout=30_000)
    assert questions == [], "to stop replaces nothing"
    assert panel.unsaved(), "it has grown since it was saved"

    questions.answer = False
    qtbot.waitUntil(lambda: panel.form.going_live.enabled, timeout=30_000)
    panel.form.going_live.native.click()
    scene = np.random.default_rng(0).random((300, 300))
    viewer.add_image(np.stack([scene[k:][:200, :200] for k in range(6)]), name="mine", contrast_limits=(0, 1))
    panel.form.recording.value = "mine"
    panel.form.start.native.click()
    assert [question.split(" replaces")[0] for question in questions] == [
        "The new live mosaic",
        "The mosaic of the selected stack",
    ]
    assert not panel.work.busy
    assert not panel.requests.busy
    assert panel._shown is first

    qtbot.wait(200)
    panel.save(tmp_path / "late.ome.tif")
    qtbot.waitUntil(lambda: not panel.work.busy and panel.form.going_live.enabled, timeout=30_000)
    assert panel.unsaved() == ""
    panel.form.going_live.native.click()
    qtbot.waitUntil(lambda: panel._shown is not first, timeout=30_000)
    assert len(questions) == 2


def test_an_unsaved_live_mosaic_is_cleared_only_if_the_user_agrees(viewer, panel, qtbot, go_live, questions):
    """Before: Ctrl+Shift+K, beside the key of the live mosaic, discarded it."""
    go_live(viewer, panel, qtbot)
    questions.answer = False
    panel.form.clearing.native.click()
    assert questions == ["The mosaic was not saved. Discard it?"]
    assert panel.live
    assert "mosaic LS" in viewer.layers
    questions.answer = True
    panel.form.clearing.native.click()
    qtbot.waitUntil(lambda: panel.connection.client.status.track is None, timeout=30_000)
    assert "mosaic LS" not in viewer.layers


def test_a_live_mosaic_that_is_being_prepared_is_cancelled_at_once(panel, qtbot):
    """Before: nothing could be pressed while the first one compiled kernels, for some ten seconds."""
    client, prepared, commanded = panel.connection.client, Future(), []
    client.track = lambda plan: (commanded.append(plan), prepared)[1]
    panel.form.going_live.native.click()
    qtbot.waitUntil(lambda: panel.form.going_live.text == "Cancel", timeout=30_000)
    panel.form.going_live.native.click()
    assert commanded == [panel.form.plan, None]
    assert not panel.waiting
    assert (panel.form.going_live.text, panel.form.going_live.enabled) == ("Live mosaic", True)
    prepared.set_result(None)
    qtbot.wait(200)
    assert not client.status.live


def test_a_stack_that_cannot_be_used_leaves_the_live_mosaic_as_it_is(viewer, panel, qtbot, go_live):
    go_live(viewer, panel, qtbot)
    first = panel._shown
    viewer.add_image(np.full((4, 60, 60), np.nan), name="broken", contrast_limits=(0, 1))
    panel.form.recording.value = "broken"
    panel.begin()
    qtbot.waitUntil(lambda: not panel.work.busy, timeout=60_000)
    rows = len(first.rows)
    qtbot.waitUntil(lambda: len(first.rows) > rows, timeout=30_000)
    assert panel._shown is first
    assert viewer.layers["broken"].visible


def test_the_rig_is_connected_by_the_calibration_that_the_panels_share(viewer, qtbot, go_live):
    known = small_calibration()
    _, panel = viewer.window.add_plugin_dock_widget(PLUGIN, "Mosaic")
    panel.connection.apply(known)
    for mode, box in panel.form.modes.items():
        box.value = mode == "ls"
    go_live(viewer, panel, qtbot)
    assert panel.connection.client.calibration == known
