"""The recorder's thread by itself: where a recording ends."""

from __future__ import annotations

from pathlib import Path
from threading import Event
from threading import enumerate as threads
from typing import NoReturn

import pytest

from napari_elsplus.acquisition.streaming.faults import FaultLog
from napari_elsplus.acquisition.streaming.recorder import Recorder, RecordingPlan
from napari_elsplus.acquisition.streaming.stream import FrameStream
from napari_elsplus.acquisition.streaming.tally import Tally
from napari_elsplus.errors import InputError
from napari_elsplus.hardware.protocols import FrameInfo
from waiting import until


def test_a_recording_that_is_stopped_ends_though_no_further_frame_comes(tmp_path: Path) -> None:
    """Before: with the next frame, which a camera that hangs sends never."""
    stream, faults = FrameStream((8, 8), frames=16), FaultLog()
    recorder = Recorder(
        stream,
        RecordingPlan(tmp_path / "r.ome.tif"),
        frame_rate_hz=100.0,
        calibration=None,
        settings={},
        tally=Tally(),
        faults=faults,
    )
    try:
        for number in range(5):
            stream.finalize(stream.acquire(), FrameInfo(number, 0.0, 0.01 * number))
        until(lambda: recorder.frames == 5)
        recorder.stop()
        recorder.join(10)
        assert not recorder.is_alive()
    finally:
        stream.end()
        recorder.join()
    assert (recorder.frames, recorder.missing, faults.all()) == (5, 0, ())


@pytest.mark.parametrize("lost_later", [0, 6])
def test_frames_that_a_recorder_lost_stay_counted_when_the_next_one_begins(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, lost_later: int
) -> None:
    """Before: the next recording of the run put its own count in their place."""
    stream, faults, tally = FrameStream((8, 8), frames=16), FaultLog(), Tally()
    write, come = Recorder._write, Event()

    def write_later(recorder: Recorder) -> None:
        assert come.wait(10)
        write(recorder)

    monkeypatch.setattr(Recorder, "_write", write_later)

    def record(name: str, lost: int) -> None:
        come.clear()
        recorder = Recorder(
            stream,
            RecordingPlan(tmp_path / name, frames=5),
            frame_rate_hz=100.0,
            calibration=None,
            settings={},
            tally=tally,
            faults=faults,
        )
        for number in range(lost + 16 if lost else 5):  # the memory holds 16
            stream.finalize(stream.acquire(), FrameInfo(number, 0.0, 0.01 * number))
        come.set()
        recorder.join(10)
        assert recorder.frames == 5

    record("first.ome.tif", lost=4)
    lost = tally.dropped["recorder slow"]
    assert lost >= 4
    record("second.ome.tif", lost=lost_later)
    assert tally.dropped["recorder slow"] >= lost + lost_later
    stream.end()
    assert faults.all() == ()


@pytest.mark.parametrize("runs", [False, True])
def test_a_recorder_that_is_interrupted_as_it_begins_leaves_no_file_thread_or_cursor(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, runs: bool
) -> None:
    """Before: the empty file stayed, and the thread that flushes it went on as long as the program."""
    stream, faults, start = FrameStream((8, 8), frames=16), FaultLog(), Recorder.start
    for number in range(8):
        stream.finalize(stream.acquire(), FrameInfo(number, 0.0, 0.01 * number))

    def interrupted(recorder: Recorder) -> NoReturn:
        if runs:
            start(recorder)
        raise KeyboardInterrupt

    monkeypatch.setattr(Recorder, "start", interrupted)
    with pytest.raises(KeyboardInterrupt):
        Recorder(
            stream,
            RecordingPlan(tmp_path / "r.ome.tif"),
            frame_rate_hz=100.0,
            calibration=None,
            settings={},
            tally=Tally(),
            faults=faults,
        )
    try:
        assert not {"recorder", "recording-flush"} & {thread.name for thread in threads()}
        assert not stream._cursors
        assert list(tmp_path.iterdir()) == []
        assert faults.all() == ()
    finally:
        stream.end()


def test_a_plan_takes_the_name_of_a_file() -> None:
    """Before: the recording began, and whatever asked for it raised an AttributeError."""
    assert RecordingPlan("r.ome.tif").path == Path("r.ome.tif")
    with pytest.raises(InputError, match="a path is expected, the number 3 was given"):
        RecordingPlan(3)  # type: ignore[arg-type]
