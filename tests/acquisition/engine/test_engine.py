from __future__ import annotations

import errno
import os
import shutil
import sys
import time
from collections.abc import Callable
from contextlib import nullcontext, suppress
from pathlib import Path
from threading import Event, Thread
from threading import enumerate as threads
from typing import Any

import numpy as np
import pytest

from napari_elsplus.acquisition.calibrating.capture import take_sweep
from napari_elsplus.acquisition.engine.engine import Engine
from napari_elsplus.acquisition.engine.live_images import LiveView
from napari_elsplus.acquisition.engine.status import Settings
from napari_elsplus.acquisition.streaming.recorder import Recorder, RecordingPlan
from napari_elsplus.errors import CalibrationError, DeviceError, InputError
from napari_elsplus.hardware.parking import ParkStage, ParkState
from napari_elsplus.instrument.calibration import Calibration
from napari_elsplus.io import RecordingWriter, open_recording
from napari_elsplus.processing.images.sectioning import side_px
from napari_elsplus.workflows.sectioning import section
from waiting import until


def newest(engine: Engine, *names: str) -> tuple[int, dict[str, np.ndarray]]:
    ring = engine.display
    assert ring is not None
    out = {name: np.empty(shape, dtype) for name, shape, dtype in ring.layout.fields if name in names}
    stamp = None
    while stamp is None:
        stamp = ring.newest_after(-1, out)
    return stamp.frame_number, out


def test_every_frame_has_its_result(engine: Engine, calibration: Calibration) -> None:
    engine.use(calibration)
    engine.start()
    until(lambda: engine.status().acquired >= 60)
    engine.stop()
    status = engine.status()
    assert status.processed == status.acquired
    assert status.dropped == {}
    assert 0 < status.latency_ms.p50 <= status.latency_ms.p99 <= status.latency_ms.max
    assert status.mean_hz == pytest.approx(100, rel=0.05)


def test_live_images_are_those_of_the_pipeline(engine: Engine, calibration: Calibration) -> None:
    background = np.full((524, 1328), 3, np.float32)
    assert calibration.bundle is not None
    on_grid = tuple(
        c + (side_px(calibration.bundle.diameter_px) - 1) / 2 % 1 for c in calibration.bundle.confocal_centre
    )
    bundle = calibration.bundle.model_copy(update={"confocal_centre": on_grid})  # live images are on the camera's grid
    engine.use(calibration.model_copy(update={"background": background, "bundle": bundle}))
    engine.start()
    until(lambda: engine.status().processed > 12)
    engine.stop()
    _, shown = newest(engine, "raw", "ls", "residual", "els")
    for mode in ("ls", "residual", "els"):
        expected = section(shown["raw"][None], engine.calibration, mode)[0]  # type: ignore[arg-type]
        np.testing.assert_array_equal(shown[mode], expected)


def test_a_recording_holds_every_frame_with_number_and_time(
    engine: Engine, calibration: Calibration, tmp_path: Path
) -> None:
    engine.use(calibration)
    engine.start()
    engine.record(RecordingPlan(tmp_path / "r.ome.tif"))
    until(lambda: engine.status().recorded >= 40)
    engine.stop()
    engine.finish_recording()
    with open_recording(tmp_path / "r.ome.tif") as recording:
        assert len(recording) == engine.status().recorded
        assert (np.diff(recording.frame_numbers) == 1).all()
        assert np.diff(recording.times_s) == pytest.approx(0.01, abs=1e-6)
        numbers = [int(np.ascontiguousarray(frame[0, :8]).view(np.int64)[0]) for frame in recording]
        assert numbers == recording.frame_numbers.tolist()
        assert recording.calibration is not None
        assert recording.calibration.bundle == calibration.bundle
        assert recording.metadata["settings"]["rig"] == "small"


def test_a_recording_ends_by_frames_and_by_seconds(engine: Engine, tmp_path: Path) -> None:
    engine.start()
    engine.record(RecordingPlan(tmp_path / "frames.ome.tif", frames=7))
    until(lambda: not engine.status().recording.running)  # type: ignore[union-attr]
    engine.record(RecordingPlan(tmp_path / "seconds.ome.tif", seconds=0.2))
    until(lambda: not engine.status().recording.running)  # type: ignore[union-attr]
    state = engine.status().recording
    assert state is not None
    assert (state.seconds, state.missing) == (pytest.approx(0.2, abs=1e-6), 0)
    with open_recording(tmp_path / "frames.ome.tif") as recording:
        assert len(recording) == 7
    with open_recording(tmp_path / "seconds.ome.tif") as recording:
        assert len(recording) == 20


@pytest.mark.parametrize("limit", [{"frames": 10**12}, {"seconds": 1e12}])
def test_a_recording_that_does_not_fit_on_the_disk_is_refused(
    engine: Engine, tmp_path: Path, limit: dict[str, Any]
) -> None:
    engine.start()
    with pytest.raises(OSError, match=r"do not fit into the .* GB that are free on its disk"):
        engine.record(RecordingPlan(tmp_path / "r.ome.tif", **limit))
    assert list(tmp_path.iterdir()) == []


def test_a_recording_can_begin_before_it_was_asked_for(engine: Engine, tmp_path: Path) -> None:
    engine.start()
    until(lambda: engine.status().acquired >= 50)
    before = engine.status().acquired
    engine.record(RecordingPlan(tmp_path / "r.ome.tif", earlier_s=0.3, frames=40))
    after = engine.status().acquired
    until(lambda: not engine.status().recording.running)  # type: ignore[union-attr]
    with open_recording(tmp_path / "r.ome.tif") as recording:
        assert before - 30 <= recording.frame_numbers[0] - 2 <= after - 30 + 1  # one may be written, not yet counted
        assert (np.diff(recording.frame_numbers) == 1).all()


def test_a_slow_disk_takes_none_of_the_frames_from_before(
    engine: Engine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened = RecordingWriter.__init__

    def opens_slowly(writer: RecordingWriter, *arguments: Any, **options: Any) -> None:
        opened(writer, *arguments, **options)
        asked = engine.status().acquired
        until(lambda: engine.status().acquired >= asked + 8)

    monkeypatch.setattr(RecordingWriter, "__init__", opens_slowly)
    engine.start()
    until(lambda: engine.status().acquired >= 50)
    engine.record(RecordingPlan(tmp_path / "r.ome.tif", earlier_s=0.3, frames=40))
    after = engine.status().acquired
    until(lambda: not engine.status().recording.running)  # type: ignore[union-attr]
    with open_recording(tmp_path / "r.ome.tif") as recording:
        assert recording.frame_numbers[0] - 2 <= after - 8 - 30 + 1


def test_an_existing_recording_is_kept(engine: Engine, tmp_path: Path) -> None:
    (tmp_path / "r.ome.tif").write_bytes(b"mine")
    engine.start()
    with pytest.raises(InputError, match="exists"):
        engine.record(RecordingPlan(tmp_path / "r.ome.tif"))
    assert (tmp_path / "r.ome.tif").read_bytes() == b"mine"


@pytest.mark.skipif(os.name == "nt", reason="a file that is open cannot be removed there")
def test_a_recording_whose_folder_is_removed_is_not_said_to_be_readable(engine: Engine, tmp_path: Path) -> None:
    """The user was told to free some disk space, and that what was written is readable."""
    folder = tmp_path / "session"
    folder.mkdir()
    engine.start()
    engine.record(RecordingPlan(folder / "r.ome.tif"))
    until(lambda: engine.status().recorded > 5)
    shutil.rmtree(folder)
    until(lambda: bool(engine.status().faults))
    (fault,) = engine.status().faults
    assert fault.source == "recorder"
    assert "ended after" in fault.problem
    assert "was removed" in fault.remedy
    assert "readable" not in fault.remedy


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (OSError(errno.ENOSPC, "No space left on device"), "No space left"),
        (InputError("frame 9 is of another size", "start another recording"), "frame 9"),
    ],
)
def test_a_recorder_that_fails_completes_its_file_and_ends_nothing_else(
    engine: Engine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception, said: str
) -> None:
    append = RecordingWriter.append

    def fails(writer: RecordingWriter, *arguments: Any, **options: Any) -> None:
        if len(writer) == 9:
            raise error
        append(writer, *arguments, **options)

    monkeypatch.setattr(RecordingWriter, "append", fails)
    engine.start()
    engine.record(RecordingPlan(tmp_path / "r.ome.tif"))
    until(lambda: bool(engine.status().faults))
    before = engine.status().processed
    until(lambda: engine.status().processed > before + 10)
    until(lambda: not engine.status().recording.running)  # type: ignore[union-attr]
    (fault,) = engine.status().faults
    assert fault.source == "recorder"
    assert said in fault.problem
    with open_recording(tmp_path / "r.ome.tif") as recording:
        assert len(recording) == 9
        assert recording.metadata["frame_period_s"] > 0  # written with the end of the file


def test_missing_frames_are_counted_by_cause(engine: Engine, rig: Any) -> None:
    rig.camera.skipped_numbers = {10, 11, 20}
    engine.start()
    until(lambda: engine.status().acquired >= 30)
    engine.stop()
    assert engine.status().dropped == {"camera: gap": 3}


def test_what_a_camera_skips_before_its_first_good_frame_is_not_lost(engine: Engine, rig: Any) -> None:
    start = rig.camera.start

    def start_and_skip() -> None:
        start()
        rig.camera.dropped = {"invalid after a change": 2}

    rig.camera.start = start_and_skip
    engine.start()
    engine.stop()
    engine.start()  # the engine itself has no frames to throw away any more
    until(lambda: engine.status().acquired >= 10)
    engine.stop()
    assert engine.status().dropped == {}


def test_gaps_that_the_camera_does_not_explain_are_counted_too(engine: Engine, rig: Any) -> None:
    class Forgetful(dict[str, int]):
        def __setitem__(self, key: str, value: int) -> None:
            pass

    start = rig.camera.start

    def start_and_forget() -> None:
        start()
        rig.camera.dropped = Forgetful()

    rig.camera.start = start_and_forget
    rig.camera.skipped_numbers = {10, 11}
    engine.start()
    until(lambda: engine.status().acquired >= 30)
    engine.stop()
    assert engine.status().dropped == {"camera: missing numbers": 2}


def test_a_slow_consumer_is_counted_and_does_not_hold_the_camera_up(engine: Engine) -> None:
    class Slow:
        def add(self, raw: np.ndarray, stamp: Any) -> None:
            time.sleep(0.05)

    engine.track(Slow())
    engine.start()
    until(lambda: "processing slow" in engine.status().dropped)
    status = engine.status()
    assert status.camera_hz == pytest.approx(100, rel=0.1)
    engine.track(None)
    engine.stop()
    status = engine.status()
    assert status.acquired == status.processed + status.dropped["processing slow"]


def test_a_slow_disk_costs_recorded_frames_and_says_so(
    engine: Engine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    append = RecordingWriter.append

    def slowly(writer: RecordingWriter, *arguments: Any, **options: Any) -> None:
        time.sleep(0.1 if len(writer) < 20 else 0)
        append(writer, *arguments, **options)

    monkeypatch.setattr(RecordingWriter, "append", slowly)
    engine.start()
    engine.record(RecordingPlan(tmp_path / "r.ome.tif"))
    until(lambda: "recorder slow" in engine.status().dropped)
    engine.stop()
    engine.finish_recording()
    status = engine.status()
    with open_recording(tmp_path / "r.ome.tif") as recording:
        missing = int((np.diff(recording.frame_numbers) - 1).sum())
    assert missing == status.dropped["recorder slow"]
    assert status.recording is not None
    assert status.recording.missing == missing
    assert status.processed == status.acquired


def test_an_unplugged_camera_parks_the_mirror_and_keeps_the_data(
    engine: Engine, rig: Any, calibration: Calibration, tmp_path: Path
) -> None:
    rig.camera.unplugged_at = 30
    engine.use(calibration)
    engine.start()
    engine.record(RecordingPlan(tmp_path / "r.ome.tif"))
    until(lambda: not engine.status().live)
    assert rig.scanner.calls[-1] == "park"
    assert [fault.problem for fault in engine.status().faults] == ["the camera was unplugged"]
    engine.finish_recording()
    with open_recording(tmp_path / "r.ome.tif") as recording:
        assert recording.frame_numbers[-1] == 29
    rig.camera.unplugged_at = None
    engine.start()
    until(lambda: engine.status().acquired > 5)
    assert engine.status().faults == ()


def test_a_fault_of_the_mirror_stops_the_stream(engine: Engine, rig: Any, calibration: Calibration) -> None:
    engine.use(calibration)
    engine.start()
    rig.scanner.fault = DeviceError("the strobe was lost", "check its cable")
    until(lambda: not engine.status().live)
    assert rig.scanner.calls[-1] == "park"
    assert [fault.problem for fault in engine.status().faults] == ["the strobe was lost"]
    with pytest.raises(DeviceError, match="the strobe was lost"):  # the cause, not "no frames stream"
        engine.fresh_frames(1)


@pytest.mark.parametrize("part", ["scanner.park", "camera.stop"])
def test_a_driver_that_fails_with_another_error_than_those_of_devices_does_not_hold_up_the_stop(
    engine: Engine, rig: Any, monkeypatch: pytest.MonkeyPatch, part: str
) -> None:
    """Drivers from outside this package raise what they will. Before: the stream went on, and no error was stated."""
    device, name = part.split(".")
    call, failures = getattr(getattr(rig, device), name), [RuntimeError("handle is closed")]

    def failing() -> None:
        call()
        if failures:
            raise failures.pop()

    monkeypatch.setattr(sys, "excepthook", lambda *_: None)
    engine.start(scan=False)
    engine.hold(0.2)
    monkeypatch.setattr(getattr(rig, device), name, failing)
    engine.stop()
    assert not rig.camera.streams
    assert {thread.name for thread in threads()}.isdisjoint({"camera", "processing"})
    assert [(fault.source, fault.problem) for fault in engine.status().faults] == [
        (device, "RuntimeError: handle is closed")
    ]


def test_other_settings_stop_the_scan_and_the_first_two_frames_are_not_used(
    engine: Engine, rig: Any, calibration: Calibration
) -> None:
    engine.use(calibration)
    engine.start()
    until(lambda: engine.status().acquired > 3)
    rig.scanner.calls.clear()
    engine.configure(Settings("240hz", slit_rows=5, frame_rate_hz=80.0))
    assert rig.scanner.calls[:2] == ["park", "scan"]
    (first,) = engine.fresh_frames(1)
    assert int(np.ascontiguousarray(first[0, :8]).view(np.int64)[0]) >= 2
    assert engine.status().stale == {}


@pytest.mark.parametrize("fails", [False, True])
def test_other_settings_do_not_scan_again_where_the_galvo_was_parked(
    engine: Engine, rig: Any, calibration: Calibration, fails: bool
) -> None:
    """Before: the line was back on the tissue by a change of the gain."""
    engine.use(calibration)
    engine.start()
    until(lambda: engine.status().acquired > 3)
    engine.park()
    rig.scanner.calls.clear()
    with pytest.raises(InputError) if fails else nullcontext():
        engine.configure(Settings("240hz", slit_rows=101 if fails else 5, frame_rate_hz=80.0))
    until(lambda: engine.status().live and engine.status().processed > 3)
    assert "scan" not in rig.scanner.calls
    assert not engine.status().scanning


def test_what_other_settings_make_stale_is_said(engine: Engine, calibration: Calibration) -> None:
    made_with = {"slit_rows": 3, "frame_rate_hz": 100.0, "objective": "10x"}
    engine.use(Calibration.parse({**calibration.content(), "acquired_with": made_with}))
    engine.start()
    assert engine.status().stale["bundle"] == "objective changed from 10x to 4x"


def test_the_name_of_a_calibration_is_refused_and_the_one_before_stays(
    engine: Engine, calibration: Calibration
) -> None:
    engine.use(calibration)
    ring = engine.display
    with pytest.raises(InputError, match=r"'cal\.json' is a name: give `load_calibration\('cal\.json'\)`"):
        engine.use("cal.json")  # type: ignore[arg-type]
    assert engine.calibration is calibration
    assert engine.display is ring


def test_a_view_that_cannot_be_made_leaves_the_one_before(engine: Engine, calibration: Calibration) -> None:
    engine.use(calibration)
    engine.start()
    with pytest.raises(CalibrationError, match="flat"):
        engine.show(LiveView(flat_field=True))
    engine.show(LiveView(average=4))
    until(lambda: engine.status().processed > 3)


def test_an_engine_without_calibration_shows_raw_frames_and_leaves_the_mirror(engine: Engine, rig: Any) -> None:
    engine.start()
    until(lambda: engine.status().processed > 3)
    assert not engine.status().scanning
    assert "scan" not in rig.scanner.calls
    assert {name for name, _, _ in engine.display.layout.fields} == {"raw"}  # type: ignore[union-attr]
    with pytest.raises(InputError, match="no calibration"):
        engine.scan()


def test_the_mirror_parks_where_the_calibration_says_and_else_where_the_rig_does(
    engine: Engine, rig: Any, calibration: Calibration
) -> None:
    assert calibration.galvo is not None
    own = rig.scanner.park_v
    elsewhere = calibration.galvo.model_copy(update={"park_v": -0.9})
    engine.use(calibration.model_copy(update={"galvo": elsewhere}))
    engine.start()
    engine.stop()
    assert rig.scanner.volts == -0.9
    outside = calibration.galvo.model_copy(update={"park_v": -9.0})
    with pytest.raises(InputError, match="parking position"):
        engine.use(calibration.model_copy(update={"galvo": outside}))
    assert engine.calibration is not None
    assert engine.calibration.galvo == elsewhere
    assert rig.scanner.park_v == -0.9
    engine.use(calibration)
    assert rig.scanner.park_v == own


def test_a_mirror_that_scans_is_parked_when_nothing_says_how_to(
    engine: Engine, rig: Any, calibration: Calibration
) -> None:
    engine.use(calibration)
    engine.start()
    assert engine.status().scanning
    engine.use(None)
    assert not engine.status().scanning
    assert rig.scanner.calls[-1] == "park"


def test_a_hold_that_is_refused_leaves_the_scan_which_is_parked_where_nothing_says_how_to(
    engine: Engine, rig: Any, calibration: Calibration, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before: no scan was claimed while the galvo scanned on, and without a calibration it went on."""

    def refuse(volts: float) -> None:
        raise InputError(f"{volts} V for the galvo", "the rig's limits are -2 to 2 V")

    monkeypatch.setattr(rig.scanner, "hold", refuse)
    engine.use(calibration)
    engine.start()
    with pytest.raises(InputError, match="9"):
        engine.hold(9.0)
    assert engine.status().scanning
    engine.use(None)
    assert rig.scanner.calls[-1] == "park"


def test_a_ramp_that_is_impossible_leaves_the_scan_and_the_images_before(
    engine: Engine, rig: Any, calibration: Calibration
) -> None:
    assert calibration.galvo is not None
    engine.use(calibration)
    engine.start()
    scans = rig.scanner.calls.count("scan")
    steep = calibration.galvo.model_copy(update={"volts_per_row": 0.1})
    smaller = calibration.bundle.model_copy(update={"diameter_px": 400.0})  # type: ignore[union-attr]
    with pytest.raises(InputError):
        engine.use(calibration.model_copy(update={"galvo": steep, "bundle": smaller}))
    assert engine.status().scanning
    assert rig.scanner.calls.count("scan") == scans
    assert {name: shape for name, shape, _ in engine.display.layout.fields}["els"] == (466, 466)  # type: ignore[union-attr]


def test_starting_without_settings_is_refused(rig: Any) -> None:
    with Engine(rig) as engine, pytest.raises(InputError, match="unconfigured"):
        engine.start()


def test_a_camera_that_does_not_start_leaves_the_mirror_parked(
    engine: Engine, rig: Any, calibration: Calibration
) -> None:
    def fails() -> None:
        raise DeviceError("the camera does not answer", "connect again")

    rig.camera.start = fails
    engine.use(calibration)
    with pytest.raises(DeviceError, match="does not answer"):
        engine.start()
    assert rig.scanner.calls[-1] == "park"
    assert not engine.status().live


def fast(calibration: Calibration) -> Calibration:
    """A calibration whose ramp leaves no time to fly back."""
    assert calibration.galvo is not None
    galvo = {"volts_per_row": -0.005, "volts_at_row_zero": 1.3, "park_v": -1.9}
    return calibration.model_copy(update={"galvo": calibration.galvo.model_copy(update=galvo)})


def test_a_ramp_that_does_not_fit_is_refused_with_its_remedy(engine: Engine, calibration: Calibration) -> None:
    engine.use(fast(calibration))
    engine.configure(Settings("240hz"))
    with pytest.raises(InputError, match="fly back"):
        engine.start()
    status = engine.status()
    assert not status.live
    assert not status.scanning
    engine.use(calibration)
    engine.start()
    until(lambda: engine.status().processed > 3)


@pytest.mark.parametrize("live", [False, True])
def test_a_configuration_that_fails_half_way_leaves_the_one_before(
    engine: Engine, rig: Any, calibration: Calibration, live: bool
) -> None:
    configure = rig.camera.configure

    def half_way(region: Any, *, gain_db: float, **options: Any) -> None:
        configure(region, gain_db=gain_db, **options)
        if gain_db > 24:
            raise InputError(f"a gain of {gain_db} dB", "24 dB is the highest")

    rig.camera.configure = half_way
    engine.use(calibration)
    if live:
        engine.start()
    with pytest.raises(InputError, match="gain of 60"):
        engine.configure(Settings("240hz", frame_rate_hz=50.0, gain_db=60.0))
    assert rig.camera.rate_hz == engine.setup.settings.frame_rate_hz == 100.0
    assert engine.status().live is live
    if live:
        until(lambda: engine.status().scanning and engine.status().processed > 3)


def test_a_camera_that_cannot_be_restored_is_unconfigured_and_does_not_start(engine: Engine, rig: Any) -> None:
    def broken(*_: Any, **__: Any) -> None:
        raise DeviceError("the camera does not answer", "connect again")

    configure, rig.camera.configure = rig.camera.configure, broken
    engine.start()
    with pytest.raises(DeviceError, match="does not answer"):
        engine.configure(Settings("240hz", frame_rate_hz=50.0))
    assert not engine.status().configured
    assert not engine.status().live
    with pytest.raises(InputError, match="unconfigured"):
        engine.start()
    rig.camera.configure = configure
    engine.configure(Settings("240hz", frame_rate_hz=50.0))
    engine.start()
    until(lambda: engine.status().processed > 3)


def test_a_preset_that_the_calibration_does_not_fit_is_refused_at_start(
    engine: Engine, calibration: Calibration
) -> None:
    engine.use(Calibration.parse({**calibration.content(), "frame": {"shape": [524, 1328], "sensor_origin": [262, 0]}}))
    engine.configure(Settings("120hz", frame_rate_hz=100.0))
    with pytest.raises(CalibrationError, match="calibrate for the preset 120hz"):
        engine.start()
    engine.start(scan=False)  # as a calibration of this preset does
    until(lambda: engine.status().processed > 3)
    assert engine.status().faults == ()
    engine.stop()
    engine.configure(Settings("240hz", frame_rate_hz=100.0))
    engine.start()
    with pytest.raises(CalibrationError):
        engine.configure(Settings("120hz", frame_rate_hz=100.0))
    assert engine.setup.settings.preset == "240hz"
    until(lambda: engine.status().scanning and engine.status().processed > 3)


def test_nothing_that_changes_the_frames_is_done_while_they_are_recorded(
    engine: Engine, calibration: Calibration, tmp_path: Path
) -> None:
    engine.start()
    engine.record(RecordingPlan(tmp_path / "r.ome.tif"))
    with pytest.raises(InputError, match="is being recorded: end the recording first"):
        engine.configure(Settings("240hz", frame_rate_hz=100.0, gain_db=6.0))
    with pytest.raises(InputError, match="is being recorded: end the recording first"):
        engine.use(calibration)
    recorded = engine.status().recorded
    until(lambda: engine.status().recorded > recorded + 3)
    engine.stop_recording()
    engine.use(calibration)


def test_a_second_operation_is_refused_and_told_what_runs(engine: Engine) -> None:
    engine.start()
    entered, leave = Event(), Event()

    def sweep() -> None:
        with engine.operations.alone("the sweep", long=True):
            entered.set()
            leave.wait(20)

    thread = Thread(target=sweep)
    thread.start()
    entered.wait(20)
    try:
        for operation in (engine.start, engine.stop, lambda: engine.configure(Settings()), lambda: engine.hold(0.1)):
            with pytest.raises(InputError, match="the sweep is running"):
                operation()
        assert engine.status().live
    finally:
        leave.set()
        thread.join()
    engine.stop()


def test_park_waits_for_nothing_and_what_ran_does_not_move_the_galvo_again(engine: Engine, rig: Any) -> None:
    engine.start()
    raised: list[Exception] = []

    def sweep() -> None:
        try:
            take_sweep(engine, np.linspace(-0.3, 0.3, 10_000))
        except InputError as error:
            raised.append(error)

    def procedure() -> None:
        with engine.operations.alone("the sweep", long=True):
            sweep()

    thread = Thread(target=procedure)
    thread.start()
    until(lambda: rig.scanner.calls.count("hold") > 3)
    engine.park()
    thread.join(5)
    assert not thread.is_alive()
    assert "the galvo was parked, so the sweep has ended" in str(raised[0])
    assert rig.scanner.calls[-1] == "park"


def test_a_recording_of_a_stream_that_has_ended_by_itself_names_the_cause(
    engine: Engine, rig: Any, tmp_path: Path
) -> None:
    """Before: nothing to record, start the stream first."""
    rig.camera.unplugged_at = 2
    engine.start(scan=False)
    until(lambda: not engine.status().live)
    with pytest.raises(DeviceError, match="the camera was unplugged"):
        engine.record(RecordingPlan(tmp_path / "r.ome.tif"))


def test_a_recording_can_be_stopped_while_it_begins(
    engine: Engine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before: the thread that had not started yet was waited for, which Python refuses."""
    start = Recorder.start

    def stop_then_start(recorder: Recorder) -> None:
        engine.stop_recording()
        start(recorder)

    monkeypatch.setattr(Recorder, "start", stop_then_start)
    engine.start(scan=False)
    engine.record(RecordingPlan(tmp_path / "r.ome.tif", frames=3))
    until(lambda: engine.status().recorded == 3)


def test_of_a_galvo_that_is_parked_as_a_scan_begins_no_scan_is_claimed(
    engine: Engine, calibration: Calibration, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before: one was, for good, where parking came after the last look of the command to scan."""
    engine.use(calibration)
    engine.start(scan=False)
    check, last = engine.operations.check, iter([False, True])

    def check_then_park() -> None:
        check()
        if next(last):
            thread = Thread(target=engine.park)
            thread.start()
            thread.join()

    monkeypatch.setattr(engine.operations, "check", check_then_park)
    engine.scan()
    assert engine.galvo.park_state.parked
    assert not engine.galvo.scanning


def test_park_is_at_once_while_a_view_is_made(
    engine: Engine, rig: Any, calibration: Calibration, monkeypatch: pytest.MonkeyPatch
) -> None:
    engine.use(calibration)
    engine.start()
    making, made = Event(), Event()

    def slowly(**_: Any) -> None:
        making.set()
        made.wait(20)
        raise CalibrationError("no view", "choose another")

    monkeypatch.setattr(engine._display, "renew", slowly)

    def show() -> None:
        with suppress(CalibrationError):
            engine.show(LiveView())

    thread = Thread(target=show)
    thread.start()
    making.wait(20)
    begun_s = time.monotonic()
    engine.park()
    assert time.monotonic() - begun_s < 1.0
    assert rig.scanner.calls[-1] == "park"
    made.set()
    thread.join()


@pytest.mark.parametrize("part", ["tracker", "recorder", "sectioning"])
def test_frames_go_on_whatever_fails_beside_them(
    engine: Engine, calibration: Calibration, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, part: str
) -> None:
    def fails(*_: Any, **__: Any) -> None:
        raise ZeroDivisionError(f"in the {part}")

    monkeypatch.setattr(sys, "excepthook", lambda *_: None)
    engine.use(calibration)
    if part == "tracker":
        engine.track(type("Tracker", (), {"add": fails})())
    if part == "recorder":
        monkeypatch.setattr(RecordingWriter, "append", fails)
    if part == "sectioning":
        monkeypatch.setattr(engine._display.sink.images, "add", fails)  # type: ignore[union-attr]
    engine.start()
    engine.record(RecordingPlan(tmp_path / "r.ome.tif"))
    until(lambda: any(part in fault.problem for fault in engine.status().faults))
    before = engine.status()
    until(lambda: engine.status().processed > before.processed + 10)
    assert engine.status().live
    if part != "recorder":
        until(lambda: engine.status().recorded > before.recorded + 10)


def test_a_galvo_that_is_not_parked_is_shown_with_what_to_do_by_hand(
    rig: Any, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    refusing = ParkState(ParkStage.NOT_PARKED, "the card is in use by another program")
    told: list[Callable[[ParkState], None]] = []
    monkeypatch.setattr(type(rig.scanner), "park_state", property(lambda _: refusing))
    monkeypatch.setattr(type(rig.scanner), "on_park_state", lambda _, call: told.append(call) or told.clear)
    with Engine(rig) as engine:
        engine.configure(Settings("240hz", frame_rate_hz=100.0))
        told[0](refusing)
        status = engine.status()
        assert "NOT PARKED: switch the laser off" in status.faults[0].problem
        assert "NOT PARKED: switch the laser off" in status.report()["galvo"]["message"]
        told[0](ParkState(ParkStage.PARKED, "the line is reserved"))
        assert not any("NOT PARKED" in fault.problem for fault in engine.status().faults)
        assert "parked late" in engine.status().faults[0].problem
        assert "laser's line was not switched off" in engine.status().faults[-1].problem
    assert "NOT PARKED: switch the laser off" in caplog.text
    assert not told
