"""The driver on a camera that keeps to the standard's text, and on those that real ones differ by.

Each test is a fault that a driver had which was tested only against a device of its own making.
"""

from __future__ import annotations

import errno
import threading
import time
from struct import pack, unpack

import numpy as np
import pytest
from usb import util
from usb.core import USBTimeoutError

from napari_elsplus.errors import DeviceError, InputError
from napari_elsplus.hardware.protocols import HasClock, Region
from napari_elsplus.hardware.u3v.camera import CameraClock, U3vCamera
from napari_elsplus.hardware.u3v.discovery import choose_camera
from napari_elsplus.hardware.virtual.camera import descriptors
from napari_elsplus.hardware.virtual.camera.bus import VirtualBus
from sfnc_camera import StandardRegisters
from virtual_devices import read_frames

SMALL = Region(262, 0, 40, 64)
PAPER = Region(262, 0, 524, 1328)
FULL = Region(0, 0, 1048, 1328)


def stream(camera: U3vCamera, count: int = 5, region: Region = SMALL, rate_hz: float = 100):
    camera.configure(region, slit_rows=3, frame_rate_hz=rate_hz)
    camera.start()
    return read_frames(camera, count)


def kill(camera: U3vCamera) -> None:
    """Leave a camera as a program does that is killed: nothing is commanded, the system closes the device."""
    camera._stream.stop()
    camera._stream = None
    util.dispose_resources(camera._device)


def without_memory_channels(bench) -> None:
    """Let the default settings not be loaded at once, by register 624h."""
    del bench.plug.camera.memory._registers[0xFFFF_F0F0_0624]
    bench.plug.camera.memory.add({})


# A program before was killed, or left the camera changed.


@pytest.mark.parametrize("region", [SMALL, FULL])
def test_a_camera_that_streams_since_its_program_was_killed_is_opened_again(cameras, region) -> None:
    bench = cameras()
    before = bench.open()
    stream(before, 3, FULL)
    kill(before)
    assert bench.plug.camera.stream.enabled  # a camera does not notice
    bench.plug.camera.faults.halt_stream = 1
    with bench.open() as camera:
        assert not bench.plug.camera.stream.enabled
        infos = stream(camera, 5, region)
        assert [info.frame_number for info in infos] == list(range(2, 7))
        assert set(camera.dropped) <= {"invalid after a change", "halted endpoint"}


def test_an_answer_that_a_killed_program_left_unread_is_not_taken_for_ours(cameras) -> None:
    bench = cameras()
    for number in range(1, 6):  # the first numbers of any program that begins to count at 1
        unread = pack("<4sHHHHQHH", b"U3VC", 0x4000, 0x0800, 12, number, 0x0104, 0, 64)
        bench.plug.camera.control_endpoint.write(unread)
    with bench.open() as camera:
        assert (camera.model, camera.serial) == ("virtual FL3-U3-13S2M", "4711")


@pytest.mark.parametrize("left", ["gamma", "trigger", "frame_info", "binning"])
def test_what_another_program_left_on_is_switched_off(cameras, left) -> None:
    bench = cameras(real_time=False)
    setattr(bench.plug.camera.sensor.settings, left, 2 if left == "binning" else 3 if left == "frame_info" else True)
    with bench.open(wait_for_reader=True) as camera:
        stream(camera, 3, FULL)


@pytest.mark.parametrize("left", ["gamma", "trigger", "frame_info", "binning"])
def test_without_memory_channels_it_is_switched_off_as_well(cameras, left) -> None:
    bench = cameras(real_time=False)
    without_memory_channels(bench)
    setattr(bench.plug.camera.sensor.settings, left, 2 if left == "binning" else 3 if left == "frame_info" else True)
    with bench.open(wait_for_reader=True) as camera:
        stream(camera, 3, FULL)


def test_a_gamma_that_cannot_be_switched_off_is_refused_by_name(cameras) -> None:
    from napari_elsplus.hardware.virtual.camera.memory import number

    bench = cameras(real_time=False)
    bench.plug.camera.memory.add({0xFFFF_F0F0_0818: number(lambda: 1 << 25, lambda _: None)})
    with pytest.raises(DeviceError, match="keeps gamma switched on"):
        bench.open()


def test_chunk_data_are_named_and_not_counted_as_bad_leaders(cameras) -> None:
    """A Flea3 has no register for it; what the leader says is believed."""
    bench = cameras()
    with bench.open() as camera:
        camera.configure(SMALL, slit_rows=3, frame_rate_hz=100)
        bench.plug.camera.sensor.settings.chunks = True
        camera.start()
        with pytest.raises(DeviceError, match="ChunkModeActive"):
            read_frames(camera, 1)


@pytest.mark.parametrize("memory_channels", [True, False])
def test_a_strobe_delay_that_another_program_set_is_taken_back(cameras, memory_channels) -> None:
    bench = cameras(real_time=False)
    if not memory_channels:
        without_memory_channels(bench)
    bench.plug.camera.make.pins.times[1] = 4000 << 16
    with bench.open(wait_for_reader=True) as camera:
        stream(camera, 1)
        shot = bench.bench.shots[0]
        assert bench.bench.trains[-1].start_s == pytest.approx(shot.strobe_s, abs=1e-9)


# The control channel.


def test_a_busy_camera_is_asked_again(cameras) -> None:
    bench = cameras()
    with bench.open() as camera:
        bench.plug.camera.faults.busy_acks = 6
        stream(camera, 2)
        assert bench.plug.camera.faults.busy_acks == 0


def test_a_camera_that_answers_late_is_awaited_for_the_time_that_it_states(cameras) -> None:
    bench = cameras()
    bench.plug.camera.identity.max_response_ms = 1200
    with bench.open() as camera:
        bench.plug.camera.faults.ack_delay_s = 0.8
        assert camera._features.frame_rate_hz > 0
        bench.plug.camera.faults.ack_delay_s = 0.0


def test_a_halted_control_endpoint_is_cleared(cameras) -> None:
    bench = cameras()
    with bench.open() as camera:
        bench.plug.camera.faults.halt_control = 1
        stream(camera, 2)


def test_a_lost_acknowledgement_at_the_start_does_not_shift_the_cameras_clock(cameras) -> None:
    """The virtual camera's clock is the computer's: its zero is 0."""
    for lose in (0, 1):
        bench = cameras()
        with bench.open() as camera:
            assert isinstance(camera, HasClock)
            camera.configure(SMALL, slit_rows=3, frame_rate_hz=100)
            camera._control._timeout_ms = 100
            bench.plug.camera.faults.lose_acks = lose
            camera.start()
            assert -5e-3 < camera.clock_zero_s <= 0.0


def test_an_acknowledgement_that_is_lost_at_the_latch_does_not_shift_it_either(cameras) -> None:
    bench = cameras()
    with bench.open() as camera:
        camera._control._timeout_ms = 100
        bench.plug.camera.faults.lose_acks = 1
        assert -5e-3 < camera._clock.zero_s() <= 0.0
        assert bench.plug.camera.faults.lose_acks == 0


@pytest.mark.parametrize("tick_ns", [8.0, 1000.0])
def test_the_unit_of_the_timestamps_is_measured(cameras, tick_ns) -> None:
    bench = cameras()
    bench.plug.camera.faults.tick_ns = tick_ns
    with bench.open() as camera:
        infos = stream(camera, 30)
        spacing = np.diff([info.readout_start_s for info in infos])
        np.testing.assert_allclose(spacing, 0.01, rtol=0.01)


def test_a_computer_that_is_held_up_at_a_latch_does_not_change_the_unit(cameras, monkeypatch) -> None:
    latch, times = CameraClock._latch, iter([0.01])

    def held_up(clock: CameraClock) -> tuple[float, int]:
        before_s, ticks = latch(clock)
        return before_s - next(times, 0.0), ticks

    monkeypatch.setattr(CameraClock, "_latch", held_up)
    with cameras().open() as camera:
        assert camera.tick_s == 1e-9


@pytest.mark.parametrize("latch", [True, False])
def test_frames_without_timestamps_are_timed_by_their_numbers(cameras, latch) -> None:
    bench = cameras()
    bench.plug.camera.faults.blank_timestamps, bench.plug.camera.identity.timestamps = True, latch
    with bench.open() as camera:
        infos = stream(camera, 6)
        spacing = np.diff([info.readout_start_s for info in infos])
        np.testing.assert_allclose(spacing, 0.01, rtol=1e-6)
        assert camera.clock_zero_s is None


# The stream.


@pytest.mark.parametrize(("alignment", "largest"), [(1024, 1 << 32), (4, 1 << 32), (4096, 65536), (1024, 65536 + 1024)])
def test_transfers_are_of_the_sizes_that_the_camera_holds(cameras, alignment, largest) -> None:
    bench = cameras(real_time=False)
    bench.plug.camera.stream.alignment, bench.plug.camera.stream.max_transfer = alignment, largest
    with bench.open(wait_for_reader=True) as camera:
        for region in (SMALL, PAPER, FULL):
            stream(camera, 3, region)
            assert camera.dropped == {"invalid after a change": 2}
            sizes = bench.plug.camera.stream.transfer_sizes
            assert sizes[0] <= min(1 << 20, largest)
            assert sum(sizes) < region.rows * region.cols + alignment
            assert bench.plug.camera.stream._held[0x28] == 0  # one final transfer is enough, and it is the first
            camera.stop()


def test_a_camera_that_holds_impossible_transfers_is_refused(cameras) -> None:
    bench = cameras(real_time=False)
    bench.plug.camera.stream.max_transfer = 512
    with bench.open() as camera:
        camera.configure(SMALL, slit_rows=3, frame_rate_hz=100)
        with pytest.raises(DeviceError, match="holds transfers of 512 bytes"):
            camera.start()


@pytest.mark.parametrize("megabytes_per_s", [8, 15])
def test_on_a_slow_bus_frames_are_whole(cameras, megabytes_per_s) -> None:
    """1.4 MB take 93 or 174 ms, more than the 50 ms after which the reader tests if it should stop."""
    bench = cameras()
    bench.plug.camera.faults.bus_bytes_per_s = megabytes_per_s * 1e6
    with bench.open() as camera:
        stream(camera, 3, FULL, rate_hz=5)
        assert camera.dropped == {"invalid after a change": 2}


@pytest.mark.parametrize("region", [SMALL, FULL])
def test_bytes_after_each_line_are_left_out(cameras, region) -> None:
    bench = cameras(real_time=False)
    bench.plug.camera.faults.padding_x = 16
    with bench.open(wait_for_reader=True) as camera:
        stream(camera, 4, region)
        assert camera.dropped == {"invalid after a change": 2}


def test_a_halted_stream_is_cleared_and_goes_on(cameras) -> None:
    bench = cameras()
    with bench.open() as camera:
        stream(camera, 3)
        before = read_frames(camera, 1)[0].frame_number
        bench.plug.camera.faults.halt_stream = 1
        infos = read_frames(camera, 20)
        assert not bench.plug.camera.faults.halt_stream
        missing = infos[-1].frame_number - before - len(infos)
        assert missing <= 1  # none where it halted between two frames
        assert camera.dropped.get("halted endpoint", 0) == missing


def test_a_stream_that_stays_halted_ends_and_is_not_called_unplugged(cameras) -> None:
    bench = cameras()
    with bench.open() as camera:
        stream(camera, 3)
        bench.plug.camera.faults.halt_stream = 10**6
        with pytest.raises(DeviceError, match="halted its endpoint"):
            read_frames(camera, 50)


# Settings that depend on each other.


def test_a_long_exposure_before_does_not_limit_the_rate_after(cameras) -> None:
    bench = cameras(real_time=False)
    with bench.open(wait_for_reader=True) as camera:
        camera.configure(SMALL, slit_rows=5000, frame_rate_hz=20)
        camera.configure(SMALL, slit_rows=3, frame_rate_hz=240)
        camera.configure(SMALL, slit_rows=5000, frame_rate_hz=20)
        camera.start()
        read_frames(camera, 2)
        assert bench.bench.shots[-1].exposure_s == pytest.approx(5000 * camera.line_period_s, rel=1e-5)


def test_no_permission_with_a_serial_number_says_so(cameras) -> None:
    bench, other = cameras(), cameras(serial="0815")
    bench.plug.forbidden = True
    with pytest.raises(DeviceError, match="no permission"):
        choose_camera("4711", bench.bus)
    both = VirtualBus(bench.plug, other.plug)
    assert choose_camera("0815", both).serial_number == "0815"  # the other one is not in the way
    with pytest.raises(DeviceError, match="no permission"):
        choose_camera("4711", both)


@pytest.mark.parametrize("asked", ["languages", "text"])
def test_a_camera_that_hangs_while_its_serial_number_is_read_is_no_matter_of_permission(
    cameras, monkeypatch, asked
) -> None:
    """Before: no permission, with a rule to write; or it stood in the way of the camera that was asked for."""
    bench, other = cameras(), cameras(serial="0815")
    transfer, hangs_from = VirtualBus.ctrl_transfer, {"languages": 0, "text": 1}[asked]

    def hang(self, plug, request_type, request, value, *rest):
        if plug is bench.plug and value & 0xFF >= hangs_from:
            raise USBTimeoutError("Operation timed out", -7, errno.ETIMEDOUT)
        return transfer(self, plug, request_type, request, value, *rest)

    monkeypatch.setattr(VirtualBus, "ctrl_transfer", hang)
    with pytest.raises(DeviceError, match=r"timed out: plug it in again"):
        choose_camera("4711", bench.bus)
    assert choose_camera("0815", VirtualBus(bench.plug, other.plug)).serial_number == "0815"


def test_a_camera_whose_serial_number_is_no_text_is_not_the_one_that_is_asked_for(cameras, monkeypatch) -> None:
    bench = cameras()
    texts = descriptors.string
    half_a_letter = b"\x04\x03\x00\xd8"
    monkeypatch.setattr(descriptors, "string", lambda index, serial: half_a_letter if index else texts(0, serial))
    with pytest.raises(DeviceError, match="no USB3 Vision camera with serial 4711"):
        choose_camera("4711", bench.bus)


# The device itself: what it refuses, and by which status, is the standard's.


def answer(camera, packet: bytes) -> tuple[int, bytes]:
    camera.control_endpoint.write(packet)
    got = camera.control_endpoint.read(0.1)
    status, _, length, _ = unpack("<4H", got[4:12])
    assert len(got) == 12 + length
    return status, got[12:]


def reading(address: int, count: int) -> bytes:
    return b"U3VC" + pack("<4HQHH", 0x4000, 0x0800, 12, 7, address, 0, count)


def writing(address: int, data: bytes) -> bytes:
    return b"U3VC" + pack("<4HQ", 0x4000, 0x0802, 8 + len(data), 7, address) + data


def test_the_device_refuses_by_the_standards_status_codes(cameras) -> None:
    camera = cameras().plug.camera
    (sbrm,) = unpack("<Q", answer(camera, reading(0x1D8, 8))[1])
    (sirm,) = unpack("<Q", answer(camera, reading(sbrm + 0x20, 8))[1])
    assert answer(camera, reading(0x7777_0000, 4))[0] == 0x8003  # no such address
    assert answer(camera, writing(0x44, bytes(64)))[0] == 0x8004  # read only
    assert answer(camera, reading(0x1F8, 4))[0] == 0x8006  # write only
    assert answer(camera, reading(0, 2000))[0] == 0x8002  # longer than the acknowledgement may be
    assert answer(camera, b"U3VC" + pack("<4H", 0x4000, 0x0999, 0, 7))[0] == 0x8001  # no such command
    assert answer(camera, writing(sirm + 4, pack("<I", 1)))[0] == 0xA004  # no transfers were set
    for register, value in ((0x18, 1024), (0x2C, 1024), (0x1C, 1 << 20), (0x20, 1), (0x24, 1 << 20)):
        assert answer(camera, writing(sirm + register, pack("<I", value)))[0] == 0
    assert answer(camera, writing(sirm + 0x28, pack("<I", 100)))[0] == 0
    assert answer(camera, writing(sirm + 4, pack("<I", 1)))[0] == 0xA003  # not aligned
    assert answer(camera, writing(sirm + 0x28, pack("<I", 0)))[0] == 0
    assert answer(camera, writing(sirm + 4, pack("<I", 1)))[0] == 0
    assert answer(camera, writing(sirm + 0x1C, pack("<I", 2048)))[0] == 0x8004  # locked while it is enabled
    assert answer(camera, writing(0xFFFF_F0F0_0A0C, pack("<I", 64 << 16 | 40)))[0] == 0x8006


# Another make, through its own description.


@pytest.fixture
def standard(cameras):
    pytest.importorskip("genicam", reason="EMVA's reader of descriptions (the extra genicam) is not installed")
    from napari_elsplus.hardware.u3v.genapi import GenicamFeatures

    def make(**changes):
        bench = cameras(**{"make": StandardRegisters, **changes})
        bench.open = lambda **wiring: U3vCamera(
            choose_camera("", bench.bus),
            lambda control: GenicamFeatures(control, line_rate_hz=1e5, **wiring),
            wait_for_reader=not bench.bench.clock.real_time,
        )
        return bench

    return make


def test_another_make_streams_by_its_own_description(standard) -> None:
    bench = standard(real_time=False)
    with bench.open() as camera:
        camera.configure(Region(100, 64, 480, 640), slit_rows=5, frame_rate_hz=150, gain_db=6)
        camera.start()
        read_frames(camera, 5)
        shot = bench.bench.shots[-1]
        assert (shot.region, shot.gain_db) == ((100, 64, 480, 640), 6.0)
        assert shot.exposure_s == pytest.approx(50e-6, rel=1e-5)
        assert bench.bench.trains[-1] is not None
        assert bench.plug.camera.make.parameters_locked
        camera.stop()
        assert not bench.plug.camera.make.parameters_locked
        camera.configure(Region(0, 0, 960, 1280), slit_rows=5, frame_rate_hz=50)
        with pytest.raises(InputError, match="AcquisitionFrameRate"):
            camera.configure(Region(0, 0, 960, 1280), slit_rows=5, frame_rate_hz=1e6)
        with pytest.raises(InputError, match="Height"):
            camera.configure(Region(0, 0, 1048, 1280), slit_rows=5, frame_rate_hz=50)


def test_a_fixed_output_carries_the_strobe_and_an_input_is_refused_by_name(standard) -> None:
    bench = standard(real_time=False)
    with bench.open(strobe_line=1) as camera:
        camera.configure(Region(0, 0, 480, 640), slit_rows=5, frame_rate_hz=50)
    with bench.open(strobe_line=0) as camera, pytest.raises(DeviceError, match="LineMode is Input"):
        camera.configure(Region(0, 0, 480, 640), slit_rows=5, frame_rate_hz=50)


@pytest.mark.parametrize("left", ["gamma", "trigger", "chunks", "binning"])
def test_what_was_left_on_at_another_make_is_reset(standard, left) -> None:
    bench = standard(real_time=False)
    setattr(bench.plug.camera.sensor.settings, left, 2 if left == "binning" else True)
    with bench.open() as camera:
        stream(camera, 3, Region(0, 0, 960, 1280), 50)


class WithoutUserSets(StandardRegisters):
    """A camera whose default settings cannot be loaded at once: no feature has the standard's name for it."""

    def describe(self) -> bytes:
        return super().describe().replace(b"UserSet", b"VendorSet")


@pytest.mark.parametrize("left", ["gamma", "trigger", "chunks", "binning"])
def test_without_user_sets_it_is_switched_off_as_well(standard, left) -> None:
    bench = standard(real_time=False, make=WithoutUserSets)
    setattr(bench.plug.camera.sensor.settings, left, 2 if left == "binning" else True)
    with bench.open() as camera:
        stream(camera, 3, Region(0, 0, 960, 1280), 50)
        assert getattr(bench.plug.camera.sensor.settings, left) == (1 if left == "binning" else False)


def test_a_long_exposure_before_does_not_limit_the_rate_of_another_make(standard) -> None:
    bench = standard(real_time=False)
    with bench.open() as camera:
        for slit_rows, rate_hz in ((5000, 15), (3, 80), (5000, 15)):  # 50 ms at most, of 66 or 12.5 ms
            camera.configure(Region(0, 0, 960, 1280), slit_rows=slit_rows, frame_rate_hz=rate_hz)
        camera.start()
        read_frames(camera, 2)
        assert bench.bench.shots[-1].exposure_s == pytest.approx(0.05, rel=1e-5)


def test_another_make_whose_program_was_killed_is_opened_again(standard) -> None:
    bench = standard()
    before = bench.open()
    stream(before, 3, Region(0, 0, 480, 640))
    kill(before)
    with bench.open() as camera:
        begin = time.perf_counter()
        stream(camera, 3, Region(0, 0, 96, 640))
        assert time.perf_counter() - begin < 2


@pytest.mark.parametrize("use", [
    lambda camera: camera.start(),
    lambda camera: camera.sensor,
    lambda camera: camera.frame_rate_limits_hz,
    lambda camera: camera.configure(Region(0, 0, 480, 640), slit_rows=5, frame_rate_hz=50),
])  # fmt: skip
def test_another_make_that_is_unplugged_is_one_line_and_is_closed(standard, use) -> None:
    bench = standard(real_time=False)
    camera = bench.open()
    camera.configure(Region(0, 0, 480, 640), slit_rows=5, frame_rate_hz=50)
    bench.plug.unplugged = True
    with pytest.raises(DeviceError, match="unplugged"):
        use(camera)
    camera.close()


def unavailable(name: str) -> type[StandardRegisters]:
    """Make a camera that describes a feature which is not available, as some do until another one is set."""

    class Lacking(StandardRegisters):
        def describe(self) -> bytes:
            node = f'Name="{name}">'.encode()
            return (
                super()
                .describe()
                .replace(node, node + b"<pIsAvailable>Never</pIsAvailable>", 1)
                .replace(
                    b'<Port Name="Device"/>',
                    b'<IntSwissKnife Name="Never"><Formula>0</Formula></IntSwissKnife><Port Name="Device"/>',
                )
            )

    return Lacking


def test_default_settings_that_are_not_available_are_not_loaded(standard) -> None:
    """Before: a traceback of the reader's own error."""
    bench = standard(real_time=False, make=unavailable("UserSetLoad"))
    bench.plug.camera.sensor.settings.gamma = True
    with bench.open() as camera:
        stream(camera, 3, Region(0, 0, 960, 1280), 50)
        assert not bench.plug.camera.sensor.settings.gamma


@pytest.mark.parametrize("name", ["AcquisitionStart", "AcquisitionFrameRate"])
def test_a_feature_that_is_not_available_is_one_line_and_leaves_no_stream(standard, name) -> None:
    """Before: a traceback of the reader's own error, and the stream's thread went on."""
    with standard(real_time=False, make=unavailable(name)).open() as camera:
        with pytest.raises((DeviceError, InputError), match=r"Acquisition|not available"):
            stream(camera, 3, Region(0, 0, 960, 1280), 50)
        assert "camera stream" not in {thread.name for thread in threading.enumerate()}
        if name == "AcquisitionFrameRate":
            with pytest.raises(DeviceError, match="not available"):
                camera.frame_rate_limits_hz  # noqa: B018 - it is read
