"""The real camera driver, through pyusb, on the virtual USB3 Vision camera.

Frames, settings, and every fault of the bus.
"""

from __future__ import annotations

import errno
import sys
import threading
import time
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from usb.core import USBTimeoutError

from napari_elsplus.errors import DeviceError, InputError
from napari_elsplus.hardware.protocols import Camera, Region
from napari_elsplus.hardware.u3v import discovery, flea3
from napari_elsplus.hardware.u3v.camera import U3vCamera
from napari_elsplus.hardware.u3v.discovery import choose_camera, find_cameras
from napari_elsplus.hardware.u3v.genapi import GenicamFeatures
from napari_elsplus.hardware.u3v.stream import DEPTH
from napari_elsplus.hardware.virtual.camera.bus import Plug, VirtualBus
from virtual_devices import read_frames

SMALL = Region(262, 0, 40, 64)


@pytest.mark.parametrize("region", [SMALL, Region(262, 0, 524, 1328), Region(0, 0, 1048, 1328)])
def test_frames_arrive_whole_in_order_and_none_is_lost(cameras, region) -> None:
    bench = cameras(real_time=False)
    with bench.open(wait_for_reader=True) as camera:
        camera.configure(region, slit_rows=3, frame_rate_hz=100)
        assert isinstance(camera, Camera)
        camera.start()
        infos = read_frames(camera, 30)
        assert [info.frame_number for info in infos] == list(range(2, 32))  # two are invalid after a change
        assert camera.dropped == {"invalid after a change": 2}
        spacing = np.diff([info.readout_start_s for info in infos])
        np.testing.assert_allclose(spacing, 0.01, atol=1e-6)
        camera.stop()
        camera.start()  # the same region: none is invalid
        assert read_frames(camera, 1)[0].frame_number == 0


def test_in_real_time_frames_come_at_the_cameras_rate(cameras) -> None:
    with cameras().open() as camera:
        camera.configure(SMALL, slit_rows=3, frame_rate_hz=240)
        camera.start()
        infos = read_frames(camera, 60)
        read_out_s = SMALL.rows * camera.line_period_s
        assert all(
            info.received_s > info.readout_start_s + read_out_s for info in infos
        )  # the virtual camera has our clock
        assert infos[-1].received_s - infos[0].readout_start_s > 59 / 240
        assert "gap" not in camera.dropped


@pytest.mark.parametrize("moves", [True, False], ids=["galvo moved", "galvo at rest"])
def test_a_late_simulation_skips_frames_from_before_the_galvo_was_moved_and_no_others(cameras, moves: bool) -> None:
    moved_s = [-np.inf]
    bench = cameras(moved_s=lambda: moved_s[0])
    expose = bench.bench.expose

    def late(shot, out) -> None:
        if shot.frame == 10:
            time.sleep(0.1)  # twelve frames at 120 Hz
            moved_s[0] = time.perf_counter() if moves else -np.inf
        expose(shot, out)

    bench.bench.expose = late
    with bench.open() as camera:
        camera.configure(SMALL, slit_rows=3, frame_rate_hz=120)
        camera.start()
        numbers = [info.frame_number for info in read_frames(camera, 20)]
    after = numbers[numbers.index(10) + 1]
    assert after >= 20 if moves else after == 11
    assert np.diff(numbers[numbers.index(after) :]).max() == 1
    assert bench.bench.shots[-1].skipped == after - 11  # for which nothing lit the specimen


def test_what_is_set_is_what_the_sensor_does(cameras) -> None:
    bench = cameras(real_time=False)
    with bench.open(wait_for_reader=True) as camera:
        camera.configure(Region(262, 16, 524, 640), slit_rows=5, frame_rate_hz=200, gain_db=6)
        assert camera.frame_shape == (524, 640)
        assert camera.line_period_s == pytest.approx(1 / 130_751)  # the camera tells whole rows per second
        assert camera.line_periods_per_frame == pytest.approx(130_751 / 200, rel=1e-6)
        camera.start()
        read_frames(camera, 2)
        shot = bench.bench.shots[-1]
        assert shot.region == (262, 16, 524, 640)
        assert shot.exposure_s == pytest.approx(5 * camera.line_period_s, rel=1e-5)
        assert shot.gain_db == pytest.approx(6)
        assert bench.bench.trains[-1].period_s == pytest.approx(1 / 200)


def test_a_camera_that_does_not_tell_its_line_rate_is_believed_to_have_the_rigs(cameras) -> None:
    bench = cameras(real_time=False)
    bench.plug.camera.make.line_frequency = 0xFFFFFFFF
    with bench.open(line_rate_hz=131_000.0) as camera:
        assert camera.line_period_s == 1 / 131_000


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"frame_rate_hz": 300}, "1 to 240"),
        ({"slit_rows": 0}, "at least 1"),
        ({"slit_rows": 900}, "exposure"),
        ({"gain_db": 60}, "0 to 24 dB"),
        ({"region": Region(600, 0, 524, 1328)}, "1048 x 1328"),
        ({"region": Region(0, 0, 523, 1328)}, "steps"),
        ({"region": Region(1, 0, 524, 1328)}, "steps"),
    ],
)
def test_what_the_camera_cannot_do_is_refused_with_its_limit(cameras, changes, told) -> None:
    with cameras(real_time=False).open() as camera:
        wanted = {"region": Region(262, 0, 524, 1328), "slit_rows": 3, "frame_rate_hz": 240} | changes
        with pytest.raises(InputError, match=told):
            camera.configure(wanted.pop("region"), **wanted)


def test_a_camera_whose_settings_were_refused_half_way_does_not_start(cameras) -> None:
    """Before: it started with the new region and rate, and the exposure that rates are set with."""
    with cameras().open() as camera:
        camera.configure(SMALL, slit_rows=3, frame_rate_hz=100)
        with pytest.raises(InputError):
            camera.configure(SMALL, slit_rows=10_000, frame_rate_hz=100)
        with pytest.raises(DeviceError, match="not configured"):
            camera.start()
        camera.configure(SMALL, slit_rows=3, frame_rate_hz=100)
        camera.start()
        assert read_frames(camera, 1)


def test_a_camera_that_refuses_to_acquire_does_not_stream(cameras, monkeypatch) -> None:
    """Before: it counted as streaming after errors other than the device's, and could not be started any more."""

    def refuse() -> None:
        raise InputError("TLParamsLocked = 1", "the camera allows other values")

    with cameras().open() as camera:
        camera.configure(SMALL, slit_rows=3, frame_rate_hz=100)
        with monkeypatch.context() as patched:
            patched.setattr(camera._features, "start", refuse)
            with pytest.raises(InputError):
                camera.start()
        camera.start()
        assert read_frames(camera, 1)


def test_a_camera_that_does_not_answer_requests_of_the_bus_is_one_line(cameras, monkeypatch) -> None:
    """Before: a traceback, also of `doctor`."""

    def time_out(*_: object) -> None:
        raise USBTimeoutError("Operation timed out", -7, errno.ETIMEDOUT)

    bench = cameras()
    monkeypatch.setattr(bench.bus, "get_configuration", time_out)
    with pytest.raises(DeviceError, match="timed out: plug it in again"):
        bench.open()


def test_it_is_not_configured_while_it_streams_nor_read_while_it_does_not(cameras) -> None:
    with cameras(real_time=False).open(wait_for_reader=True) as camera:
        with pytest.raises(DeviceError, match="configure it first"):
            camera.start()
        camera.configure(SMALL, slit_rows=3, frame_rate_hz=100)
        with pytest.raises(DeviceError, match="start it first"):
            camera.read_into(np.empty((40, 64), np.uint8), 1)
        camera.start()
        with pytest.raises(DeviceError, match="stop it"):
            camera.configure(SMALL, slit_rows=4, frame_rate_hz=100)
        for wrong in (np.empty((40, 63), np.uint8), np.empty((40, 64)), np.empty((80, 64), np.uint8)[::2]):
            with pytest.raises(InputError, match="buffer"):
                camera.read_into(wrong, 1)


def test_nothing_comes_within_the_time_out(cameras) -> None:
    with cameras().open() as camera:
        camera.configure(SMALL, slit_rows=3, frame_rate_hz=1)
        camera.start()
        with pytest.raises(TimeoutError):
            camera.read_into(np.empty((40, 64), np.uint8), 0.05)


def test_the_whole_driver_works_through_the_cameras_own_description(cameras) -> None:
    pytest.importorskip("genicam")
    bench = cameras(real_time=False)
    with U3vCamera(choose_camera("", bench.bus), GenicamFeatures, wait_for_reader=True) as camera:
        camera.configure(Region(262, 16, 524, 640), slit_rows=5, frame_rate_hz=200, gain_db=6)
        camera.start()
        assert len(read_frames(camera, 5)) == 5
        shot = bench.bench.shots[-1]
        assert (shot.region, shot.gain_db) == ((262, 16, 524, 640), 6.0)
        assert shot.exposure_s == pytest.approx(5 * camera.line_period_s, rel=1e-5)
        assert bench.bench.trains[-1] is not None  # the strobe is on
        camera.stop()
        with pytest.raises(InputError, match="AcquisitionFrameRate"):
            camera.configure(SMALL, slit_rows=5, frame_rate_hz=1e6)


# Faults.


def test_no_camera_iidc_firmware_and_a_usb_2_link_are_three_different_messages(cameras) -> None:
    bench = cameras()
    said = []
    for change in ({"unplugged": True}, {"unplugged": False, "iidc": True}, {"iidc": False, "speed": 3}):
        for name, value in change.items():
            setattr(bench.plug, name, value)
        with pytest.raises(DeviceError) as told:
            bench.open()
        said.append(str(told.value))
    assert "no USB3 Vision camera is connected" in said[0]
    assert "IIDC" in said[1]
    assert "update the firmware" in said[1]
    assert "USB 2" in said[2]


@pytest.mark.parametrize(("platform", "remedy"), [("linux", 'ATTR{idVendor}=="1e10"'), ("win32", "Zadig")])
def test_no_permission_says_what_to_do(cameras, monkeypatch, platform, remedy) -> None:
    monkeypatch.setattr(discovery.sys, "platform", platform)
    bench = cameras()
    bench.plug.forbidden = True
    with pytest.raises(DeviceError, match="no permission") as told:
        bench.open()
    assert remedy in str(told.value)


def test_a_camera_that_is_open_elsewhere_is_left_alone(cameras) -> None:
    bench = cameras()
    with bench.open(), pytest.raises(DeviceError, match="open in another program"):
        bench.open()
    with bench.open():  # let go, it can be opened again
        pass


def test_of_two_cameras_the_serial_number_chooses(cameras) -> None:
    first, second = cameras(), cameras(serial="0815")
    bus = VirtualBus(first.plug, second.plug)
    assert len(find_cameras(bus)) == 2
    with pytest.raises(DeviceError, match="2 cameras"):
        choose_camera("", bus)
    assert choose_camera("0815", bus).serial_number == "0815"
    with pytest.raises(DeviceError, match="serial 99"):
        choose_camera("99", bus)


def test_unplugged_while_streaming_ends_the_stream_and_keeps_what_came(cameras) -> None:
    bench = cameras()
    camera = bench.open()
    camera.configure(SMALL, slit_rows=3, frame_rate_hz=200)
    camera.start()
    read_frames(camera, 3)
    bench.plug.unplugged = True
    with pytest.raises(DeviceError, match="unplugged"):
        read_frames(camera, 50)
    begin = time.perf_counter()
    camera.close()
    assert time.perf_counter() - begin < 2
    assert not [thread for thread in threading.enumerate() if thread.name == "camera stream"]
    bench.plug.unplugged = False
    with bench.open() as again:
        again.configure(SMALL, slit_rows=3, frame_rate_hz=200)
        again.start()
        read_frames(again, 3)


@pytest.mark.parametrize(
    ("fault", "cause"), [("bad_trailers", "bad trailer"), ("short_frames", "short frame"), ("drop_frames", "gap")]
)
@pytest.mark.parametrize("region", [SMALL, Region(0, 0, 1048, 1328)])
def test_a_spoilt_frame_is_dropped_and_counted_and_the_next_one_is_whole(cameras, fault, cause, region) -> None:
    bench = cameras(real_time=False)
    with bench.open(wait_for_reader=True) as camera:
        camera.configure(region, slit_rows=3, frame_rate_hz=100)
        camera.start()
        before = read_frames(camera, 4)
        setattr(bench.plug.camera.faults, fault, 3)
        after = read_frames(camera, 20 + DEPTH)
        numbers = [info.frame_number for info in before + after]
        assert numbers[-1] - numbers[0] + 1 - len(numbers) == 3
        assert camera.dropped[cause] == 3


def test_a_slow_consumer_loses_frames_by_count_and_memory_does_not_grow(cameras) -> None:
    bench = cameras()
    with bench.open() as camera:
        camera.configure(SMALL, slit_rows=3, frame_rate_hz=200)
        camera.start()
        time.sleep(0.4)
        infos = read_frames(camera, DEPTH + 10)
        assert camera.dropped["slow consumer"] > 10
        numbers = [info.frame_number for info in infos]
        assert numbers[:DEPTH] == list(range(2, 2 + DEPTH))  # the oldest are kept, in order
        assert numbers == sorted(numbers)


def test_empty_packets_and_a_device_that_asks_for_time_are_borne(cameras) -> None:
    bench = cameras(real_time=False)
    with bench.open(wait_for_reader=True) as camera:
        bench.plug.camera.faults.pending_acks = 3
        bench.plug.camera.faults.lose_acks = 2
        bench.plug.camera.faults.empty_packets = True
        camera.configure(SMALL, slit_rows=3, frame_rate_hz=100)
        assert bench.plug.camera.faults.pending_acks == 0
        camera.start()
        read_frames(camera, 10)
        assert set(camera.dropped) == {"invalid after a change"}


def test_a_camera_that_never_answers_is_given_up(cameras) -> None:
    bench = cameras()
    bench.plug.camera.faults.lose_acks = 100
    with pytest.raises(DeviceError, match="did not answer 3 times"):
        bench.open()


def test_stopping_is_quick_and_starting_again_is_clean(cameras) -> None:
    with cameras().open() as camera:
        camera.configure(SMALL, slit_rows=3, frame_rate_hz=100)
        for _ in range(3):
            camera.start()
            read_frames(camera, 3)
            begin = time.perf_counter()
            camera.stop()
            assert time.perf_counter() - begin < 1
            camera.stop()


def test_while_the_camera_stops_its_frames_stay_counted(cameras, monkeypatch) -> None:
    """Before: none were, for as long as stopping takes, and the interlock took that for frames that come."""
    with cameras().open() as camera:
        camera.configure(SMALL, slit_rows=3, frame_rate_hz=100)
        camera.start()
        read_frames(camera, 3)
        counted: list[int] = []
        monkeypatch.setattr(camera._features, "stop", lambda: counted.append(camera.frames_received))
        camera.stop()
        assert 3 <= counted[0] <= camera.frames_received


def test_only_usb3_vision_devices_are_cameras(cameras) -> None:
    bench = cameras()
    other = Plug(bench.plug.camera, iidc=True)
    assert find_cameras(VirtualBus(other)) == []
    assert len(find_cameras(bench.bus)) == 1


def test_the_flea3_can_be_built_with_another_strobe_line(cameras) -> None:
    bench = cameras(real_time=False)
    with U3vCamera(choose_camera("", bench.bus), partial(flea3.Flea3, strobe_line=2)) as camera:
        camera.configure(SMALL, slit_rows=3, frame_rate_hz=100)
    assert [bench.plug.camera.make.strobe_delay_s(line) for line in range(4)] == [None, None, 0.0, None]


# libusb.


def test_libusb_of_the_package_is_used_where_the_system_has_none(cameras, monkeypatch) -> None:
    bench, asked = cameras(), []

    def get_backend(find_library=None):
        asked.append(find_library)
        return bench.bus if find_library else None

    package = SimpleNamespace(find_library=lambda candidate: f"{candidate}.dll")
    monkeypatch.setattr("usb.backend.libusb1.get_backend", get_backend)
    monkeypatch.setitem(sys.modules, "libusb_package", package)
    assert choose_camera("4711").serial_number == "4711"
    assert set(asked) == {None, package.find_library}


def test_without_any_libusb_a_camera_cannot_be_reached_and_the_message_names_it(monkeypatch) -> None:
    for backend in ("libusb1", "libusb0", "openusb"):
        monkeypatch.setattr(f"usb.backend.{backend}.get_backend", lambda **_: None)
    monkeypatch.setitem(sys.modules, "libusb_package", None)
    with pytest.raises(DeviceError, match="libusb is not installed"):
        find_cameras()
