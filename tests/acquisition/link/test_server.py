from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from napari_elsplus.acquisition.engine.live_images import LiveView
from napari_elsplus.acquisition.engine.status import Settings
from napari_elsplus.acquisition.link.client import EngineClient
from napari_elsplus.acquisition.mosaic.feed import MosaicFeed
from napari_elsplus.acquisition.streaming.recorder import RecordingPlan
from napari_elsplus.errors import CalibrationError, DeviceError, InputError
from napari_elsplus.hardware.virtual.card.process import start_card
from napari_elsplus.instrument.calibration import Calibration
from napari_elsplus.io import open_recording
from napari_elsplus.processing.calibration.draft import Draft
from napari_elsplus.processing.calibration.steps import find_step
from napari_elsplus.processing.images.sectioning import Mode
from napari_elsplus.workflows.mosaic_plan import MosaicPlan

SLOW = Settings("240hz", frame_rate_hz=100.0)
CLEAR_V = -0.9
"""Where the calibration parks; the rig's own place is another."""
GALVO = {"volts_per_row": 0.00126, "volts_at_row_zero": -0.3, "r_squared": 1.0, "rms_rows": 0.0, "park_v": CLEAR_V}
STREAMER = f"""
import sys, time
from pathlib import Path
from napari_elsplus.acquisition.link.client import EngineClient
from napari_elsplus.acquisition.mosaic.feed import MosaicFeed
from napari_elsplus.acquisition.streaming.recorder import RecordingPlan
from napari_elsplus.acquisition.engine.status import Settings
from napari_elsplus.instrument.calibration import Calibration
GALVO = {GALVO}
path, *command = sys.argv[1:]
client = EngineClient(command)
client.open("small").result()
client.configure(Settings("240hz", frame_rate_hz=100.0)).result()
client.use(Calibration.parse(dict(galvo=GALVO))).result()
client.start().result()
client.record(RecordingPlan(Path(path))).result()
client.hold(0.25).result()
print(client.pid, flush=True)
time.sleep(600)
"""


def until(condition: Callable[[], bool], seconds: float = 20.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.01)


def exists(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return Path(f"/proc/{pid}/stat").read_text().split()[2] != "Z" if Path("/proc").is_dir() else True


def segments(pid: int) -> list[Path]:
    return list(Path("/dev/shm").glob(f"elsplus-{pid}-*"))


@pytest.fixture
def client(command: tuple[str, ...]) -> Iterator[EngineClient]:
    with EngineClient(command) as client:
        client.open("small").result(60)
        client.configure(SLOW).result(60)
        yield client


def test_images_and_status_cross_the_processes(client: EngineClient, calibration: Calibration) -> None:
    client.use(calibration).result(60)
    client.show(LiveView(average=2)).result(60)
    client.start().result(60)
    until(lambda: client.status.processed > 20)
    ring = client.display()
    assert ring is not None
    out = {"raw": np.empty((524, 1328), np.uint8), "els": np.empty((466, 466), np.float32)}
    first = ring.newest_after(-1, out)
    assert first is not None
    assert int(np.ascontiguousarray(out["raw"][0, :8]).view(np.int64)[0]) == first.frame_number
    until(lambda: client.display().newest_after(first.sequence, out) is not None)  # type: ignore[union-attr]
    assert np.abs(out["els"]).max() > 1
    assert client.status.scanning
    assert client.status.dropped == {}


def test_whoever_has_the_reply_knows_what_the_command_changed(client: EngineClient) -> None:
    for _ in range(5):
        client.start().result(60)
        assert client.status.live
        client.stop().result(60)
        assert not client.status.live


def test_the_ring_follows_the_calibration(client: EngineClient, calibration: Calibration) -> None:
    client.start().result(60)
    without = client.display()
    assert without is not None
    assert [name for name, _, _ in without.layout.fields] == ["raw"]
    client.use(calibration).result(60)
    by_it = client.display()
    assert by_it is not None
    assert len(by_it.layout.fields) == 5
    client.stop().result(60)
    if Path("/dev/shm").is_dir():
        assert len(segments(client.pid)) == 1


def test_errors_come_back_as_they_were_raised(client: EngineClient, calibration: Calibration) -> None:
    client.use(calibration).result(60)
    with pytest.raises(CalibrationError, match="flat field"):
        client.show(LiveView(flat_field=True)).result(60)
    with pytest.raises(DeviceError, match="no rig 'none'"):
        client.open("none").result(60)
    with pytest.raises(DeviceError, match="no rig is open"):
        client.start().result(60)
    client.open("small").result(60)


def test_the_mosaic_crosses_the_processes(client: EngineClient, calibration: Calibration) -> None:
    with pytest.raises(CalibrationError, match="no calibration to track by"):
        client.track(MosaicPlan()).result(60)
    client.use(calibration).result(60)
    with pytest.raises(InputError, match="ELSA"):
        client.track(MosaicPlan((Mode.ELSA,))).result(60)
    client.track(MosaicPlan((Mode.LS,))).result(60)
    client.start().result(60)
    until(lambda: client.status.track is not None and client.status.track.counts.get("tracked", 0) > 20)
    track = client.status.track
    assert track is not None
    assert track.newest is not None
    assert track.newest.state == "tracked"
    feed = MosaicFeed(track.board)
    try:
        until(lambda: feed.update() and len(feed.rows) > 30)
        assert [row.frame for row in feed.rows] == list(range(len(feed.rows)))
        image, weight = feed.canvases[0][0].read()
        assert np.ptp(image[weight > 0]) > 50  # the camera's waves
        client.track(None).result(60)
        client.stop().result(60)
        client.start().result(60)
        until(lambda: client.status.processed > 5)
        feed.update()
        rest = len(feed.rows)
        assert not feed.update()
        assert client.undo_segment().result(60)
        feed.update()
        assert feed.canvases == {}
        assert len(feed.rows) == rest
        client.clear_mosaic().result(60)
        assert client.status.track is None
        if Path("/dev/shm").is_dir():
            assert not [path for path in segments(client.pid) if path.name.startswith(track.board)]
    finally:
        feed.close()


@pytest.mark.skipif(os.name != "posix", reason="kills as POSIX does")
@pytest.mark.parametrize("killed", [False, True])
def test_of_the_mosaic_nothing_is_left(client: EngineClient, calibration: Calibration, killed: bool) -> None:
    client.use(calibration).result(60)
    client.start().result(60)
    client.track(MosaicPlan((Mode.LS,))).result(60)
    until(lambda: client.status.track is not None and client.status.track.counts.get("tracked", 0) > 5)
    feed = MosaicFeed(client.status.track.board)  # type: ignore[union-attr]
    feed.update()
    pid = client.pid
    if killed:
        os.kill(pid, signal.SIGKILL)
        until(lambda: client.died is not None)
        feed.update()  # what is mapped can still be read
    else:
        client.close()
    assert feed.canvases[0][0].read()[0].any()
    feed.close()
    until(lambda: segments(pid) == [])


def test_closing_leaves_nothing(client: EngineClient, log: Path) -> None:
    client.start().result(60)
    until(lambda: client.status.acquired > 3)
    pid = client.pid
    client.close()
    assert not exists(pid)
    assert log.read_text().split()[-1] == "park"
    assert segments(pid) == []


@pytest.mark.skipif(os.name != "posix", reason="kills as POSIX does")
def test_killed_napari_the_engine_finishes_the_recording_parks_and_ends(
    command: tuple[str, ...], log: Path, tmp_path: Path
) -> None:
    path = tmp_path / "r.ome.tif"
    napari = subprocess.Popen([sys.executable, "-c", STREAMER, str(path), *command], stdout=subprocess.PIPE, text=True)
    assert napari.stdout is not None
    engine = int(napari.stdout.readline())
    until(lambda: path.exists() and path.stat().st_size > 20 * 524 * 1328)
    napari.kill()
    napari.communicate()
    until(lambda: not exists(engine))
    assert log.read_text().split()[-1] == "park"
    assert segments(engine) == []
    with open_recording(path) as recording:
        assert len(recording) >= 20
        assert (np.diff(recording.frame_numbers) == 1).all()
        assert recording.metadata["settings"]["rig"] == "small"  # written when the file is closed in order


@pytest.mark.skipif(os.name != "posix", reason="kills as POSIX does")
def test_killed_engine_the_client_says_so_and_every_whole_frame_is_readable(
    client: EngineClient, command: tuple[str, ...], tmp_path: Path
) -> None:
    path = tmp_path / "r.ome.tif"
    client.start().result(60)
    client.record(RecordingPlan(path)).result(60)
    until(lambda: client.status.recorded > 20)
    seen = client.status.recorded
    os.kill(client.pid, signal.SIGKILL)
    until(lambda: client.died is not None)
    assert "SIGKILL" in str(client.died)
    assert client.display() is None
    with pytest.raises(DeviceError, match="ended"):
        client.start().result(60)
    with open_recording(path) as recording:
        assert len(recording) >= seen
        assert (np.diff(recording.frame_numbers) == 1).all()
    until(lambda: segments(client.pid) == [])
    with EngineClient(command) as again:
        again.open("small").result(60)


@pytest.mark.skipif(os.name != "posix", reason="kills as POSIX does")
@pytest.mark.parametrize("victim", ["engine", "napari"])
def test_whoever_is_killed_the_mirror_is_parked_at_once(victim: str, command: tuple[str, ...], tmp_path: Path) -> None:
    with start_card() as card:
        napari = subprocess.Popen(
            [sys.executable, "-c", STREAMER, str(tmp_path / "r.ome.tif"), *command, card.address],
            stdout=subprocess.PIPE,
            text=True,
        )
        assert napari.stdout is not None
        engine = int(napari.stdout.readline())
        assert card.last_volts == pytest.approx(0.25)
        os.kill(engine if victim == "engine" else napari.pid, signal.SIGKILL)
        killed_s = time.perf_counter()  # the card's clock
        until(lambda: card.last_volts == pytest.approx(CLEAR_V))
        parked = next(output for output in reversed(card.programs()) if output.resting_v == pytest.approx(CLEAR_V))
        assert parked.since_s - killed_s < 0.5
        napari.kill()
        napari.communicate()
        until(lambda: not exists(engine))


def test_a_procedure_can_be_cancelled(client: EngineClient, log: Path, calibration: Calibration) -> None:
    sweeping = client.measure_step(find_step("galvo"), Draft(calibration), 400)
    until(lambda: client.status.progress is not None and client.status.progress.done > 3)
    assert client.status.progress.total == 400  # type: ignore[union-attr]
    client.cancel().result(60)
    with pytest.raises(InputError, match="cancelled"):
        sweeping.result(60)
    assert log.read_text().split()[-1] == "park"
    assert client.status.progress is None


@pytest.mark.skipif(os.name != "posix", reason="kills as POSIX does")
def test_a_terminated_engine_ends_in_order(client: EngineClient, log: Path) -> None:
    client.start().result(60)
    pid = client.pid
    os.kill(pid, signal.SIGTERM)
    until(lambda: client.died is not None)
    assert log.read_text().split()[-1] == "park"
    assert segments(pid) == []


def test_a_process_that_does_not_start_is_said() -> None:
    with pytest.raises(DeviceError, match="did not start"):
        EngineClient((sys.executable, "-c", "raise SystemExit(3)"))
