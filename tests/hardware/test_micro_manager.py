"""A camera of Micro-Manager: its demonstration camera where that is installed, and a core by the documentation."""

from __future__ import annotations

import sys
import time
from math import floor
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest

from napari_elsplus.errors import DeviceError, InputError
from napari_elsplus.hardware.micro_manager.camera import MicroManagerCamera
from napari_elsplus.hardware.protocols import Camera, CountsFrames, Region
from napari_elsplus.hardware.rigs import open_rig
from napari_elsplus.hardware.virtual.card.card import VirtualCard
from napari_elsplus.hardware.virtual.card.grpc_server import CardServer

SENSOR = (1048, 1328)
PAPER = Region(262, 0, 524, 1328)
RATE = "TestProperty6"
"""A number within limits: the demonstration camera has no frame rate, so that it stands for one."""
DEMO = f"""
Device,Camera,DemoCamera,DCam
Property,Core,Initialize,1
Property,Core,Camera,Camera
Property,Camera,OnCameraCCDXSize,{SENSOR[1]}
Property,Camera,OnCameraCCDYSize,{SENSOR[0]}
Property,Camera,FastImage,1
"""


class DocumentedCore:
    """Functions of MMCore (its API documentation, class CMMCore) for one camera that makes frames by the clock.

    Every pixel holds the frame's number. A full circular buffer is emptied, as the core's own cameras do.
    """

    made: ClassVar[list[DocumentedCore]] = []
    limits: ClassVar = {RATE: (1.0, 250.0), "Gain": (0.0, 24.0)}
    row_step, exposure_step_ms, bytes_per_pixel, rate_held = 1, 1e-4, 1, 1.0
    camera, restarts = "Camera", False

    def __init__(self, folder: str | None = None) -> None:
        self.folder, self.loaded, self.unloaded = folder, "", 0
        self.roi, self.exposure_ms = [0, 0, SENSOR[1], SENSOR[0]], 10.0
        self.properties = {RATE: "100.0", "Gain": "0.0", "Name": "documented"}
        self.megabytes, self.buffer, self.lost = 0, [], set()
        self.before = 0
        self.start_s, self.sent, self.inserted = None, 0, 0
        self.on_unload = lambda: None
        DocumentedCore.made.append(self)

    def loadSystemConfiguration(self, path):
        if "missing" in path:
            raise FileNotFoundError(f"Path does not exist: {path}")
        self.loaded = path

    def unloadAllDevices(self):
        self.on_unload()
        self.unloaded += 1

    def getCameraDevice(self):
        return self.camera

    def clearROI(self):
        self.roi = [0, 0, SENSOR[1], SENSOR[0]]

    def setROI(self, x, y, cols, rows):
        self.roi = [x, y, cols, rows // self.row_step * self.row_step]

    def getROI(self):
        return list(self.roi)

    def getImageWidth(self):
        return self.roi[2]

    def getImageHeight(self):
        return self.roi[3]

    def getBytesPerPixel(self):
        return self.bytes_per_pixel

    def setExposure(self, milliseconds):
        self.exposure_ms = round(milliseconds / self.exposure_step_ms) * self.exposure_step_ms

    def getExposure(self):
        return self.exposure_ms

    def hasPropertyLimits(self, label, name):
        assert label == "Camera"
        if name not in self.properties:
            raise RuntimeError(f'Error in device "Camera": Invalid property name encountered: {name} (2)')
        return name in self.limits

    def getPropertyLowerLimit(self, label, name):
        return self.limits[name][0]

    def getPropertyUpperLimit(self, label, name):
        return self.limits[name][1]

    def setProperty(self, label, name, value):
        self.properties[name] = f"{value * (self.rate_held if name == RATE else 1):.4f}"

    def getProperty(self, label, name):
        return self.properties[name]

    def setCircularBufferMemoryFootprint(self, megabytes):
        self.megabytes = megabytes

    def startContinuousSequenceAcquisition(self, interval_ms):
        self.buffer, self.sent, self.inserted, self.start_s = [], 0, 0, time.perf_counter()
        self.before = 0

    def stopSequenceAcquisition(self):
        self.start_s = None

    def isSequenceRunning(self):
        return self.start_s is not None

    def getRemainingImageCount(self):
        _, _, cols, rows = self.roi
        period_s = 1 / float(self.properties[RATE])
        due = floor((time.perf_counter() - self.start_s) / period_s) if self.start_s else self.sent
        for number in range(self.sent, due):
            if number in self.lost:
                continue
            if len(self.buffer) == self.megabytes * (1 << 20) // (rows * cols):
                self.buffer.clear()
                if self.restarts:
                    self.inserted, self.before = 0, number
            elapsed_ms = (number + 1 - self.before) * period_s * 1e3
            tags = {"ImageNumber": str(self.inserted), "ElapsedTime-ms": f"{elapsed_ms:.2f}"}
            self.buffer.append({**tags, "FrameCounter": str(1000 + number)})
            self.inserted += 1
        self.sent = due
        return len(self.buffer)

    def popNextImageAndMD(self):
        if not self.buffer:
            raise IndexError("Circular buffer is empty.")
        tags = self.buffer.pop(0)
        return np.full(self.roi[:1:-1], int(tags["ImageNumber"]) % 251, np.uint8), tags


@pytest.fixture
def core(monkeypatch):
    """The core that the next camera is opened with, made anew, so that a test can change it."""
    made = type("Core", (DocumentedCore,), {})
    monkeypatch.setitem(sys.modules, "pymmcore_plus", SimpleNamespace(CMMCorePlus=made))
    return made


@pytest.fixture(params=["documented", "demonstration"])
def demo(request, tmp_path, monkeypatch):
    """Opens the documented camera, and Micro-Manager's own."""
    (tmp_path / "demo.cfg").write_text(DEMO, "utf-8")
    folder = ""
    if request.param == "documented":
        monkeypatch.setitem(sys.modules, "pymmcore_plus", SimpleNamespace(CMMCorePlus=DocumentedCore))
    else:
        pytest.importorskip("pymmcore_plus", reason="pymmcore-plus (the extra mmcore) is not installed")
        adapters = pytest.importorskip(
            "mm_test_adapters", reason="mm-test-adapters (Micro-Manager's demonstration devices) is not installed"
        )
        folder = str(adapters.device_adapter_path())
    return lambda **options: MicroManagerCamera(str(tmp_path / "demo.cfg"), RATE, folder=folder, **options)


def take(camera: MicroManagerCamera, count: int) -> list:
    buffer = np.empty(camera.frame_shape, np.uint8)
    return [camera.read_into(buffer, 5.0) for _ in range(count)]


def test_frames_come_in_order_with_number_and_time(demo) -> None:
    with demo() as camera:
        assert (camera.sensor.rows, camera.sensor.cols) == SENSOR
        low, high = camera.frame_rate_limits_hz
        assert low < 100 < high
        for region in (PAPER, Region(4, 16, 200, 320)):
            camera.configure(region, slit_rows=13, frame_rate_hz=100)
            assert isinstance(camera, Camera)
            assert isinstance(camera, CountsFrames)
            assert camera.frame_shape == region.shape
            assert 1 / (camera.line_periods_per_frame * camera.line_period_s) == pytest.approx(100)
            camera.start()
            received = camera.frames_received
            infos = take(camera, 5)
            assert [info.frame_number for info in infos] == list(range(5))
            assert (np.diff([info.readout_start_s for info in infos]) > 0).all()
            assert (np.diff([info.received_s for info in infos]) > 0).all()
            assert camera.frames_received >= received + 5
            camera.stop()
            assert camera.dropped == {}


def test_frames_that_nobody_reads_are_counted_as_lost(demo) -> None:
    with demo() as camera:
        camera.configure(PAPER, slit_rows=13, frame_rate_hz=240)
        camera.start()
        time.sleep(0.7)
        infos = take(camera, 1)
        assert camera.dropped == ({"slow consumer": infos[0].frame_number} if infos[0].frame_number else {})
        camera.stop()


def test_a_region_beyond_the_sensor_is_refused_with_its_size(demo) -> None:
    with demo() as camera:
        for region in (Region(600, 0, 524, 1328), Region(0, 16, 524, 1328)):
            with pytest.raises(InputError, match="of 1048 x 1328"):
                camera.configure(region, slit_rows=3, frame_rate_hz=100)
        with pytest.raises(DeviceError, match="not configured"):
            camera.start()


def test_a_frame_is_the_image_of_its_number(core) -> None:
    with MicroManagerCamera("my.cfg", RATE, folder="C:/mm") as camera:
        assert (core.made[-1].loaded, core.made[-1].folder) == ("my.cfg", "C:/mm")
        camera.configure(PAPER, slit_rows=3, frame_rate_hz=200, gain_db=0)
        camera.start()
        buffer = np.empty(PAPER.shape, np.uint8)
        for _ in range(10):
            info = camera.read_into(buffer, 1.0)
            assert (buffer == info.frame_number % 251).all()
            assert info.readout_start_s == pytest.approx((info.frame_number + 1) / 200, abs=1e-5)
    assert core.made[-1].unloaded == 1


def test_what_the_core_discards_and_what_the_camera_loses_are_counted_apart(core) -> None:
    with MicroManagerCamera("my.cfg", RATE, frame_number="FrameCounter") as camera:
        device = core.made[-1]
        camera.configure(PAPER, slit_rows=3, frame_rate_hz=200)
        device.lost = {3, 4, 7}
        camera.start()
        assert [info.frame_number for info in take(camera, 7)] == [0, 1, 2, 5, 6, 8, 9]
        assert camera.dropped == {"gap": 3}
        before = camera.frames_received
        device.start_s -= 1.0  # 200 frames at once, of which the buffer holds 64
        last = take(camera, 1)[0].frame_number
        assert camera.dropped == {"gap": 3, "slow consumer": last - 10}
        assert last > 60
        assert camera.frames_received >= before + 200


@pytest.mark.parametrize("tag", ["ImageNumber", "FrameCounter"])
def test_a_core_that_counts_anew_when_its_buffer_was_emptied_hides_no_loss(core, monkeypatch, tag) -> None:
    """Before: the numbers fell, and no frame counted as lost."""
    monkeypatch.setattr(core, "restarts", True)
    with MicroManagerCamera("my.cfg", RATE, frame_number=tag) as camera:
        device = core.made[-1]
        camera.configure(PAPER, slit_rows=3, frame_rate_hz=200)
        camera.start()
        before = take(camera, 10)
        time.sleep(0.9)
        after = take(camera, 10)
        truth = (
            device.sent - device.inserted + int(device.buffer[0]["ImageNumber"] if device.buffer else device.inserted)
        )
        uncertain = 0 if tag == "FrameCounter" else 2
        assert after[-1].frame_number + 1 == pytest.approx(truth, abs=uncertain)
        assert [info.frame_number - after[0].frame_number for info in after] == list(range(10))
        assert sum(camera.dropped.values()) == after[0].frame_number - 10 > 60
        seconds = after[-1].readout_start_s - before[0].readout_start_s
        assert seconds == pytest.approx((after[-1].frame_number - before[0].frame_number) / 200, abs=1e-4)
        assert camera.frames_received == pytest.approx(device.sent, abs=uncertain)


def test_the_buffer_holds_a_quarter_of_a_second(core) -> None:
    with MicroManagerCamera("my.cfg", RATE) as camera:
        camera.configure(PAPER, slit_rows=3, frame_rate_hz=240)
        camera.start()
        assert core.made[-1].megabytes * (1 << 20) / (PAPER.rows * PAPER.cols) > 0.25 * 240
        core.made[-1].start_s -= 0.2
        assert [info.frame_number for info in take(camera, 60)] == list(range(60))


@pytest.mark.parametrize(
    ("settings", "device", "told"),
    [
        ({"frame_rate_hz": 300.0}, {}, "TestProperty6 = 300: the camera allows 1 to 250"),
        ({"frame_rate_hz": 240.0}, {"rate_held": 0.5}, "TestProperty6 = 240: the camera holds 120"),
        ({"gain_db": 30.0}, {}, "Gain = 30: the camera allows 0 to 24"),
        ({"slit_rows": 0}, {}, "a slit of 0 rows"),
        ({}, {"exposure_step_ms": 1.0}, "a slit of 3 rows.* holds 0.00 us, 0.0 rows"),
        ({"region": Region(0, 0, 522, 1328)}, {"row_step": 4}, "the camera holds 520 x 1328 at 0, 0"),
    ],
)
def test_what_the_camera_does_not_hold_is_refused_and_leaves_it_unconfigured(core, settings, device, told) -> None:
    for name, value in device.items():
        setattr(core, name, value)
    with MicroManagerCamera("my.cfg", RATE, gain="Gain") as camera:
        wanted = {"region": PAPER, "slit_rows": 3, "frame_rate_hz": 100.0} | settings
        with pytest.raises(InputError, match=told):
            camera.configure(**wanted)
        with pytest.raises(DeviceError, match="not configured"):
            camera.start()


def test_a_camera_that_cannot_be_driven_is_refused_by_name(core, monkeypatch) -> None:
    with MicroManagerCamera("my.cfg", RATE) as camera, pytest.raises(InputError, match=r"gain of 6 dB.*rig's file"):
        camera.configure(PAPER, slit_rows=3, frame_rate_hz=100, gain_db=6)
    with (
        MicroManagerCamera("my.cfg", "FrameRate") as camera,
        pytest.raises(DeviceError, match=r"property .*: FrameRate"),
    ):
        camera.configure(PAPER, slit_rows=3, frame_rate_hz=100)
    with MicroManagerCamera("my.cfg", "Name") as camera, pytest.raises(DeviceError, match="'documented', no number"):
        assert camera.frame_rate_limits_hz
    monkeypatch.setattr(core, "bytes_per_pixel", 2)
    with MicroManagerCamera("my.cfg", RATE) as camera, pytest.raises(DeviceError, match="pixels of 16 bits"):
        camera.configure(PAPER, slit_rows=3, frame_rate_hz=100)
    with pytest.raises(DeviceError, match=r"cannot load missing\.cfg"):
        MicroManagerCamera("missing.cfg", RATE)
    monkeypatch.setattr(core, "camera", "")
    with pytest.raises(DeviceError, match=r"my\.cfg names no camera"):
        MicroManagerCamera("my.cfg", RATE)
    monkeypatch.setitem(sys.modules, "pymmcore_plus", None)
    with pytest.raises(DeviceError, match=r"mmcore extra is not installed.*napari-elsplus\[mmcore\]"):
        MicroManagerCamera("my.cfg", RATE)


def test_a_stream_ends_with_its_camera_and_waits_no_longer_than_it_should(core) -> None:
    with MicroManagerCamera("my.cfg", RATE, frame_number="Nummer") as camera:
        camera.configure(PAPER, slit_rows=3, frame_rate_hz=2)
        with pytest.raises(DeviceError, match="does not stream"):
            camera.read_into(np.empty(PAPER.shape, np.uint8), 0.1)
        camera.start()
        with pytest.raises(DeviceError, match="the camera streams"):
            camera.configure(PAPER, slit_rows=3, frame_rate_hz=2)
        with pytest.raises(TimeoutError):
            camera.read_into(np.empty(PAPER.shape, np.uint8), 0.05)
        with pytest.raises(InputError, match="a buffer of"):
            camera.read_into(np.empty((3, 3), np.uint8), 0.05)
        core.made[-1].start_s -= 0.5
        with pytest.raises(DeviceError, match=r"no tag Nummer: choose among ElapsedTime-ms, FrameCounter, ImageNumber"):
            take(camera, 1)
        core.made[-1].start_s = None
        core.made[-1].buffer.clear()
        with pytest.raises(DeviceError, match="the camera has stopped"):
            take(camera, 1)


def test_a_rig_file_names_it_and_the_galvo_parks_before_the_camera_closes(
    core, tmp_path, monkeypatch, wait_for
) -> None:
    (tmp_path / "rigs").mkdir()
    monkeypatch.setenv("ELSPLUS_CONFIG", str(tmp_path))
    card = VirtualCard()
    with CardServer(card) as server:
        text = f"""
            [card]
            park_v = -0.7
            address = "{server.address}"
            [camera]
            kind = "mmcore"
            [camera.micro_manager]
            config = "my.cfg"
            frame_rate = "{RATE}"
        """
        (tmp_path / "rigs" / "mine.toml").write_text(text, "utf-8")
        at_close = []
        with open_rig("mine") as rig:
            core.made[-1].on_unload = lambda: at_close.append(card.last_volts)
            rig.camera.configure(PAPER, slit_rows=3, frame_rate_hz=100)
            rig.camera.start()
            rig.scanner.hold(0.3)
            assert card.last_volts == 0.3
        assert at_close == [-0.7]


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ('kind = "mmcore"\n', 'kind = "mmcore" and the table camera.micro_manager need each other'),
        ('[camera.micro_manager]\nconfig = "a"\nframe_rate = "b"\n', "need each other"),
        ('kind = "mmcore"\n[camera.micro_manager]\nconfig = "a"\n', r"camera\.micro_manager\.frame_rate"),
        ('kind = "mmcore"\n[camera.micro_manager]\nconfig = "a"\nframe_rate = "b"\nrate = 1\n', r"micro_manager\.rate"),
    ],
)
def test_a_wrong_table_is_named(tmp_path, monkeypatch, text, told) -> None:
    (tmp_path / "rigs").mkdir()
    (tmp_path / "rigs" / "mine.toml").write_text(f"[card]\npark_v = -0.7\n[camera]\n{text}", "utf-8")
    monkeypatch.setenv("ELSPLUS_CONFIG", str(tmp_path))
    with pytest.raises(InputError, match=told):
        open_rig("mine")
