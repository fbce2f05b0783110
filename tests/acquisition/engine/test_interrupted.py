"""A stop that is interrupted half way is completed by the next, or by closing; closing that fails half way goes on."""

from __future__ import annotations

import time
from threading import Thread
from threading import enumerate as threads

import pytest

from napari_elsplus.acquisition.engine.engine import Engine
from napari_elsplus.acquisition.engine.status import Settings
from napari_elsplus.acquisition.streaming.recorder import RecordingPlan
from napari_elsplus.acquisition.streaming.shared_memory import SharedRing
from napari_elsplus.io import open_recording

PLACES = {"galvo.try_to_park": "close", "galvo.watch_frames": "stop", "_run._camera_worker.join": "close"}
"""Where the interruption comes, and what completes the stop."""


def interrupt_once(engine: Engine, place: str, monkeypatch: pytest.MonkeyPatch) -> None:
    *owners, name = place.split(".")
    owner = engine
    for attribute in owners:
        owner = getattr(owner, attribute)
    call, interruptions = getattr(owner, name), [KeyboardInterrupt()]

    def interrupted(*arguments: object) -> object:
        if interruptions:
            raise interruptions.pop()
        return call(*arguments)

    monkeypatch.setattr(owner, name, interrupted)


@pytest.mark.parametrize(("place", "then"), PLACES.items())
def test_an_interrupted_stop_is_completed(engine: Engine, rig, tmp_path, monkeypatch, place, then) -> None:
    """Before: the recorder was waited for, without end, while it recorded and the galvo was not parked."""
    engine.start(scan=False)
    engine.hold(0.2)
    engine.record(RecordingPlan(tmp_path / "frames.ome.tif"))
    while engine.status().recorded < 5:
        time.sleep(0.01)
    interrupt_once(engine, place, monkeypatch)
    with pytest.raises(KeyboardInterrupt):
        engine.stop()

    def end() -> None:
        getattr(engine, then)()
        engine.finish_recording()

    ending = Thread(target=end, daemon=True)
    ending.start()
    ending.join(10)
    assert not ending.is_alive()
    assert rig.scanner.park_state.parked
    assert not rig.camera.streams
    with open_recording(tmp_path / "frames.ome.tif") as recording:
        assert len(recording) >= 5


@pytest.mark.parametrize("place", ["galvo.try_to_park", "_end_run", "_rig.close", "galvo.close"])
def test_closing_that_is_interrupted_ends_the_watch_and_releases_devices_and_memory(rig, monkeypatch, place) -> None:
    """Before: the watch's thread, or the images in shared memory, stayed as long as the program."""
    engine = Engine(rig, make_ring=SharedRing.create, buffer_s=1.0)
    engine.configure(Settings("240hz", frame_rate_hz=100.0))
    assert engine.display is not None
    name, layout = engine.display.name, engine.display.layout
    interrupt_once(engine, place, monkeypatch)
    with pytest.raises(KeyboardInterrupt):
        engine.close()
    assert "engine-watch" not in {thread.name for thread in threads()}
    assert rig.scanner.calls[-1] == "close" or place == "_rig.close"
    with pytest.raises(FileNotFoundError):
        SharedRing.attach(name, layout)
