from __future__ import annotations

import os
import signal
import sys
from pathlib import Path
from threading import Event, Thread

import numpy as np
import pytest

from napari_elsplus.acquisition.engine.live_images import LiveView
from napari_elsplus.acquisition.engine.status import Settings
from napari_elsplus.acquisition.link.client import EngineClient
from napari_elsplus.acquisition.mosaic.feed import MosaicFeed
from napari_elsplus.errors import CalibrationError, DeviceError, InputError
from napari_elsplus.instrument.calibration import Calibration
from napari_elsplus.processing.calibration.draft import Draft
from napari_elsplus.processing.calibration.steps import find_step
from napari_elsplus.processing.images.sectioning import Mode
from napari_elsplus.workflows.mosaic_plan import MosaicPlan
from processes import runs, segments
from waiting import until


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


@pytest.mark.skipif(os.name != "posix", reason="kills as POSIX does")
@pytest.mark.parametrize("killed", [False, True])
def test_of_the_mosaic_nothing_is_left(own_client: EngineClient, calibration: Calibration, killed: bool) -> None:
    own_client.use(calibration).result(60)
    own_client.start().result(60)
    own_client.track(MosaicPlan((Mode.LS,))).result(60)
    until(lambda: own_client.status.track is not None and own_client.status.track.counts.get("tracked", 0) > 5)
    feed = MosaicFeed(own_client.status.track.board)  # type: ignore[union-attr]
    feed.update()
    pid = own_client.pid
    if killed:
        os.kill(pid, signal.SIGKILL)
        until(lambda: own_client.died is not None)
        feed.update()  # what is mapped can still be read
    else:
        own_client.close()
    assert feed.canvases[0][0].read()[0].any()
    feed.close()
    until(lambda: segments(pid) == [])


def test_a_procedure_can_be_cancelled(client: EngineClient, shared_log: Path, calibration: Calibration) -> None:
    sweeping = client.measure_step(find_step("galvo"), Draft(calibration), 400)
    until(lambda: client.status.progress is not None and client.status.progress.done > 3)
    assert client.status.progress.total == 400  # type: ignore[union-attr]
    client.cancel().result(60)
    with pytest.raises(InputError, match="cancelled"):
        sweeping.result(60)
    assert shared_log.read_text().split()[-1] == "park"
    assert client.status.progress is None


@pytest.mark.skipif(os.name != "posix", reason="kills as POSIX does")
@pytest.mark.parametrize("how", ["closed", "terminated"])
def test_an_engine_that_is_ended_parks_and_leaves_nothing(own_client: EngineClient, log: Path, how: str) -> None:
    own_client.start().result(60)
    until(lambda: own_client.status.acquired > 3)
    pid = own_client.pid
    if how == "closed":
        own_client.close()
    else:
        os.kill(pid, signal.SIGTERM)
        until(lambda: own_client.died is not None)
    assert not runs(pid)
    assert log.read_text().split()[-1] == "park"
    assert segments(pid) == []


def test_a_process_that_does_not_start_is_said() -> None:
    with pytest.raises(DeviceError, match="did not start"):
        EngineClient((sys.executable, "-c", "raise SystemExit(3)"))


@pytest.mark.parametrize("rounds", [20, pytest.param(300, marks=pytest.mark.slow)])
def test_disconnecting_while_images_are_copied(own_client: EngineClient, calibration: Calibration, rounds: int) -> None:
    out = {"raw": np.empty((524, 1328), np.uint8)}
    out |= {name: np.empty((466, 466), np.float32) for name in ("ls", "residual", "els", "elsa")}
    reading, stopping = Event(), Event()
    raised: list[Exception] = []

    def read() -> None:
        while not stopping.is_set():
            try:
                ring = own_client.display()
                while ring is not None and len(ring.layout.fields) == 5 and not stopping.is_set():
                    reading.set()
                    if ring.newest_after(-1, out) is None:
                        break
            except Exception as error:  # noqa: BLE001
                raised.append(error)
                reading.set()
                return

    reader = Thread(target=read)
    reader.start()
    for _ in range(rounds):
        own_client.open("small").result(60)
        own_client.configure(Settings("240hz", frame_rate_hz=60.0)).result(60)
        own_client.use(calibration).result(60)
        own_client.start().result(60)
        until(lambda: own_client.status.processed > 2)
        reading.clear()
        assert reading.wait(20)
        own_client._detach()  # as `close` does, in a thread beside the one that copies
    stopping.set()
    own_client.close()
    reader.join(20)
    assert not raised
    assert not reader.is_alive()
