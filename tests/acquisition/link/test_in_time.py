"""What a process must do in time: streams of which no frame is lost, and a galvo that is parked at once."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from napari_elsplus.acquisition.engine.live_images import LiveView
from napari_elsplus.acquisition.link.client import EngineClient
from napari_elsplus.acquisition.mosaic.feed import MosaicFeed
from napari_elsplus.acquisition.streaming.recorder import RecordingPlan
from napari_elsplus.errors import CalibrationError, DeviceError, InputError
from napari_elsplus.hardware.virtual.card.process import start_card
from napari_elsplus.instrument.calibration import Calibration
from napari_elsplus.io import open_recording
from napari_elsplus.processing.images.sectioning import Mode
from napari_elsplus.workflows.mosaic_plan import MosaicPlan
from processes import runs, segments
from waiting import until

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


@pytest.mark.skipif(os.name != "posix", reason="kills as POSIX does")
def test_killed_napari_the_engine_parks_at_once_finishes_the_recording_and_ends(
    command: tuple[str, ...], tmp_path: Path
) -> None:
    path = tmp_path / "r.ome.tif"
    with start_card() as card:
        words = [sys.executable, "-c", STREAMER, str(path), *command, card.address]
        napari = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
        assert napari.stdout is not None
        engine = int(napari.stdout.readline())
        assert card.last_volts == pytest.approx(0.25)
        until(lambda: path.exists() and path.stat().st_size > 20 * 524 * 1328)
        napari.kill()
        killed_s = time.perf_counter()  # the card's clock
        napari.communicate()
        until(lambda: not runs(engine))
        parked = next(output for output in reversed(card.programs()) if output.resting_v == pytest.approx(CLEAR_V))
        assert parked.since_s - killed_s < 0.5
        assert card.last_volts == pytest.approx(CLEAR_V)
    assert segments(engine) == []
    with open_recording(path) as recording:
        assert len(recording) >= 20
        assert (np.diff(recording.frame_numbers) == 1).all()
        assert recording.metadata["settings"]["rig"] == "small"  # written when the file is closed in order


@pytest.mark.skipif(os.name != "posix", reason="kills as POSIX does")
def test_killed_engine_the_client_says_so_and_every_whole_frame_is_readable(
    own_client: EngineClient, command: tuple[str, ...], tmp_path: Path
) -> None:
    path = tmp_path / "r.ome.tif"
    own_client.start().result(60)
    own_client.record(RecordingPlan(path)).result(60)
    until(lambda: own_client.status.recorded > 20)
    seen = own_client.status.recorded
    os.kill(own_client.pid, signal.SIGKILL)
    until(lambda: own_client.died is not None)
    assert "SIGKILL" in str(own_client.died)
    assert own_client.display() is None
    with pytest.raises(DeviceError, match="ended"):
        own_client.start().result(60)
    with open_recording(path) as recording:
        assert len(recording) >= seen
        assert (np.diff(recording.frame_numbers) == 1).all()
    until(lambda: segments(own_client.pid) == [])
    with EngineClient(command) as again:
        again.open("small").result(60)


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
