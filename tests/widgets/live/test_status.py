"""What the Live panel says of the stream."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from napari_elsplus._problems import problems
from napari_elsplus.acquisition.engine.live_images import Measures
from napari_elsplus.acquisition.engine.status import ProcedureProgress, RecordingState, Status
from napari_elsplus.acquisition.streaming.faults import Fault
from napari_elsplus.errors import DeviceError
from napari_elsplus.hardware.parking import ParkStage, ParkState
from napari_elsplus.instrument.calibration import Calibration
from napari_elsplus.widgets.dock.status_line import StatusLine, newest_fault, rig_line
from napari_elsplus.widgets.live.status import status_text
from napari_elsplus.widgets.shared.connection import join
from napari_elsplus.widgets.shared.requests import RequestBar

GALVO = {"volts_per_row": 1e-3, "volts_at_row_zero": 0.0, "r_squared": 1.0, "rms_rows": 0.0}
ADVICE = "scan lag not measured: the image is off the slit"


def test_a_scan_whose_lag_is_unknown_comes_with_advice():
    late = Calibration.parse({"galvo": {**GALVO, "lag_s": 2e-4}})
    unknown = Calibration.parse({"galvo": GALVO})
    scanning, at_rest = Status(live=True, scanning=True), Status(live=True)
    zero = Calibration.parse({"galvo": {**GALVO, "lag_s": 0.0}})
    for status in (scanning, at_rest, Status()):
        assert ADVICE in status_text(status, unknown, 30.0, busy=False)
        assert ADVICE in status_text(status, zero, 30.0, busy=False)
    for known in (late, None):
        assert ADVICE not in status_text(scanning, known, 30.0, busy=False)


def test_rates_latency_losses_and_disk_are_stated(tmp_path: Path):
    recording = RecordingState(str(tmp_path / "r.ome.tif"), 480, running=True, seconds=2.0)
    free_s = 600.0
    status = Status(
        live=True, camera_hz=240.0, dropped={"recorder slow": 3}, recording=recording,
        disk_bytes_per_s=shutil.disk_usage(tmp_path).free / free_s,
    )  # fmt: skip
    text = status_text(status, None, 58.6, busy=False)
    for words in ("camera 240 Hz", "display 59 Hz", "latency", "lost: 3 (recorder slow)", "480 frames, 2.0 s"):
        assert words in text
    assert "10 min of disk space left" in text


def test_a_stream_that_begins_states_no_rate_yet():
    """Before: nan Hz."""
    text = status_text(Status(live=True, camera_hz=float("nan")), None, 0.0, busy=False)
    assert "camera ... Hz, display 0 Hz, latency ... ms" in text


def test_the_status_goes_on_where_the_folder_of_the_recording_has_gone(tmp_path: Path):
    """Before: an error at every update, as of a network drive that was lost."""
    recording = RecordingState(str(tmp_path / "gone" / "r.ome.tif"), 480, running=True, seconds=2.0)
    text = status_text(Status(live=True, recording=recording, disk_bytes_per_s=1e6), None, 0.0, busy=False)
    assert "480 frames" in text
    assert "disk space" not in text
    assert "the file is no longer there" in text
    assert "press Stop recording, and record it again" in text


def test_a_recording_that_was_removed_is_no_longer_stated_to_be_there(tmp_path: Path):
    """Before: recorded, in a folder that had vanished."""
    file = tmp_path / "r.ome.tif"
    status = Status(recording=RecordingState(str(file), 480, running=False, seconds=2.0))
    text = status_text(status, None, 0.0, busy=False)
    assert "the file is no longer there" in text
    assert "put it back, or record it again" in text
    file.write_bytes(b"frames")
    assert "no longer" not in status_text(status, None, 0.0, busy=False)


def test_a_procedure_that_prepares_is_displayed_without_a_percentage(qtbot):
    bar = RequestBar()
    qtbot.addWidget(bar)
    preparing = Status(progress=ProcedureProgress("preparing", 0, 0))
    bar.show_state(preparing, busy=True)
    assert bar.maximum() == 0, "it moves, and has no end"
    assert status_text(preparing, None, 0.0, busy=True) == "Calibrating: preparing"


def test_a_parked_galvo_is_said_while_dark_frames_stream():
    scanned = Calibration.parse({"galvo": GALVO})
    parked = Status(live=True, park_state=ParkState(ParkStage.PARKED))
    text = status_text(parked, scanned, 30.0, busy=False)
    assert "the galvo is parked" in text
    assert "press Stop, then Start, in Live" in text
    assert "calibrate, or load a calibration" in status_text(parked, None, 30.0, busy=False)
    driven = Status(live=True, scanning=True, park_state=ParkState(ParkStage.DRIVEN))
    assert "parked" not in status_text(driven, scanned, 30.0, busy=False)
    assert "galvo parked" in rig_line("simulated", parked)
    assert "parked" not in rig_line("simulated", driven)


@pytest.mark.parametrize("live", [True, False])
def test_not_parked_is_said_until_it_is_parked_whatever_else_fails(live):
    """Before: any later fault took its place, and it stayed after the galvo was parked."""
    problem = "NOT PARKED: switch the laser off (the card is in use)"
    faults = (Fault("scanner", problem, "parking goes on", 0.0), Fault("camera", "it was unplugged", "plug it in", 0.0))
    refusing = Status(live=live, park_state=ParkState(ParkStage.NOT_PARKED, "the card is in use"), faults=faults)
    assert "NOT PARKED: switch the laser off (the card is in use" in rig_line("mine", refusing)
    assert "unplugged" in newest_fault(refusing)
    parked = replace(refusing, park_state=ParkState(ParkStage.PARKED), faults=faults[:1])
    assert "galvo parked" in rig_line("mine", parked)
    assert newest_fault(parked) == ""
    assert newest_fault(replace(refusing, faults=faults[:1])) == f"{problem}: parking goes on"


def test_a_fault_of_the_stream_hides_no_error_also_after_it_was_dismissed(qtbot):
    """Before: a fault of the stream stood in the line until the next stream, also dismissed, and hid all errors."""
    fault = Fault("camera", "it was unplugged", "plug it in", 0.0)
    client = SimpleNamespace(status=Status(faults=(fault,)))
    connection = SimpleNamespace(
        client=client, connecting=None, rig="mine", died=None, calibration=None, calibration_file=None
    )
    line = StatusLine()
    qtbot.addWidget(line)

    def displayed():
        line.update_from(connection)
        return "" if line.problem.isHidden() else line.problem.text()

    assert "unplugged" in displayed()
    problems.remember("the disk is full: make room")
    assert "unplugged" in displayed()
    assert "the disk is full" in displayed()
    problems.remember(str(fault))
    assert displayed().count("unplugged") == 1, "the Live panel reports it, too"
    problems.resolve()
    assert "unplugged" in displayed()
    line.dismiss.click()
    assert displayed() == ""
    problems.remember("the disk is full: make room")
    assert "the disk is full" in displayed()
    line.dismiss.click()
    assert displayed() == ""
    client.status = Status(faults=(fault, Fault("recorder", "a second fault", "look", 0.0)))
    assert "a second fault" in displayed()
    client.status = Status()
    assert displayed() == ""
    client.status = Status(faults=(fault,))
    assert "unplugged" in displayed(), "in another stream it is new"


def test_a_disconnected_galvo_that_is_not_known_to_be_parked_is_an_error():
    """Before: the window said nothing of it any more."""
    connection = join()
    try:
        for stage, message in ((ParkStage.NOT_PARKED, "NOT PARKED"), (ParkStage.DRIVEN, "switch the laser off")):
            status = Status(park_state=ParkState(stage, "the card is in use"))
            connection._client = SimpleNamespace(close=lambda: None, status=status, died=None, calibration=None)
            connection.rig = "mine"
            with pytest.raises(DeviceError, match=message):
                connection.disconnect()
            assert connection.client is None
        connection.disconnect()
    finally:
        connection.leave()


def test_saturation_is_named_before_other_advice():
    status = Status(live=True, measures=Measures(saturated=0.02), stale={"background": "gain changed"})
    text = status_text(status, Calibration.parse({"galvo": GALVO}), 30.0, busy=False)
    assert text.count("2.0 % of the pixels are saturated: lower the laser power or the gain") == 1
    assert text.index("are saturated") < min(text.index(words) for words in ("stale", ADVICE))


def test_the_folder_of_a_recording_is_named(tmp_path: Path):
    recording = RecordingState(str(tmp_path / "r.ome.tif"), 480, running=False, seconds=2.1, missing=24)
    text = status_text(Status(recording=recording), None, 0.0, busy=False)
    assert "<b>recorded</b> r.ome.tif: 480 frames, 2.1 s, " in text
    single = Status(recording=RecordingState(str(tmp_path / "snap.ome.tif"), 1, running=False))
    assert "snap.ome.tif: 1 frame, " in status_text(single, None, 0.0, busy=False)
    assert "24 frames lost" in text
    assert f", in {tmp_path}" in text


def test_what_does_not_hold_any_more_is_said_with_its_reason():
    status = Status(live=True, stale={"background": "gain changed from 0 to 6 dB"})
    text = status_text(status, None, 30.0, busy=False)
    assert "stale: background (gain changed from 0 to 6 dB)" in text
    assert "Set it back, or measure again" in text
    assert "measure again" not in status_text(Status(live=True), None, 30.0, busy=False)


def test_the_active_calibration_is_named_with_what_was_not_measured():
    known = Calibration.parse({"created": "2026-01-31T12:00:00Z", "galvo": GALVO})
    text = status_text(Status(live=True), known, 30.0, busy=False, calibration_file=Path("bench.json"))
    assert "active calibration: bench.json, measured 2026-01-31 12:00 UTC" in text
    assert "background not measured" in text
    assert "flat field not measured" in text
    assert "active calibration: none" in status_text(Status(live=True), None, 30.0, busy=False)


@pytest.mark.parametrize("live", [False, True])
def test_a_command_that_waits_is_stated(live):
    waits = "stop waits for configure, which has not ended for 5 s"
    status = Status(live=live, waiting=waits)
    assert waits in status_text(status, None, 30.0, busy=True)
    assert waits in rig_line("simulated", status)
