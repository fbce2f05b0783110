"""Checks in the virtual machine, whose kernel has the virtual camera on its bus.

Each runs in a process of its own, with a camera that was plugged in for it.
"""

import os
import signal
import socket
import subprocess
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import usb.backend.libusb1  # noqa: F401 - before a check gives up the right to read its file

from napari_elsplus.errors import DeviceError
from napari_elsplus.hardware.protocols import Region
from napari_elsplus.hardware.u3v.camera import U3vCamera
from napari_elsplus.hardware.u3v.discovery import choose_camera
from napari_elsplus.hardware.u3v.flea3 import Flea3
from rig.aravis import AravisCamera
from rig.image import image

HOST = "10.0.2.2"
"""The computer outside, as QEMU's user network names it."""
HIGH_SPEED, SUPER_SPEED = 3, 5
"""The kernel's codes of USB 2.0 and 3.0 (include/uapi/linux/usb/ch9.h)."""
BUS = Path("/sys/devices/platform/vhci_hcd.0")
SMALL = Region(262, 0, 64, 128)
RATE_HZ = 40.0
FRAMES = 1000
LIMIT_S = 120
"""Seconds for a check."""
FREE_PORT = "004"
NOBODY = 65534


@contextmanager
def plugged_in(speed: int = SUPER_SPEED) -> Iterator[Callable[[], None]]:
    """Plug a camera in, and return what unplugs it."""
    with socket.create_connection((HOST, int(sys.argv[1]))) as connection:
        connection.sendall(b'{"attach": %d}\n' % speed)
        hub = "ss" if speed == SUPER_SPEED else "hs"
        ports = [line.split() for line in (BUS / "status").read_text().splitlines()]
        port = next(line[1] for line in ports if line[0] == hub and line[2] == FREE_PORT)
        (BUS / "attach").write_text(f"{int(port)} {connection.fileno()} 1 {speed}")

    def unplug() -> None:
        with suppress(OSError):  # unplugged already
            (BUS / "detach").write_text(str(int(port)))
        wait_for(lambda: not cameras_on_bus())

    try:
        wait_for(lambda: bool(cameras_on_bus()))
        yield unplug
    finally:
        unplug()


def cameras_on_bus() -> list[Path]:
    """Return the folders of the camera's maker in the kernel's list of devices."""
    ids = Path("/sys/bus/usb/devices").glob("*/idVendor")
    return [file.parent for file in ids if file.read_text().strip() == "1e10" and any(file.parent.glob("*:1.0"))]


def wait_for(condition: Callable[[], bool]) -> None:
    """Wait until a condition holds."""
    while not condition():
        time.sleep(0.02)


def inject(faults: str) -> None:
    """Give the camera faults, as JSON."""
    with socket.create_connection((HOST, int(sys.argv[1]))) as connection:
        connection.sendall(b'{"faults": %s}\n' % faults.encode())
        assert connection.recv(1) == b"\n"


def opened() -> U3vCamera:
    """Open the camera by this package's driver over libusb."""
    return U3vCamera(choose_camera(), Flea3)


def streamed(camera: U3vCamera, count: int) -> str:
    """Read frames of a camera that streams, with every pixel checked; return how many were lost and why."""
    buffer, numbers = np.empty(camera.frame_shape, np.uint8), []
    for _ in range(count):
        numbers.append(camera.read_into(buffer, 10.0).frame_number)
        assert (buffer == image(numbers[-1], buffer.shape)).all(), f"pixels of frame {numbers[-1]}"
    lost = {cause: n for cause, n in camera.dropped.items() if n and cause != "invalid after a change"}
    assert numbers == sorted(set(numbers))
    return f"frames {numbers[0]} to {numbers[-1]}, {count} of them with every pixel right, lost: {lost or 'none'}"


def started(camera: U3vCamera) -> U3vCamera:
    """Configure and start a camera."""
    camera.configure(SMALL, slit_rows=3, frame_rate_hz=RATE_HZ)
    camera.start()
    return camera


@contextmanager
def refused(*words: str) -> Iterator[list[str]]:
    """Demand a `DeviceError` with these words; return its text."""
    said: list[str] = []
    try:
        yield said
    except DeviceError as error:
        said.append(error.problem)
        if not all(word in str(error) for word in words):
            raise
    else:
        raise AssertionError(f"no error with {words}")


# The checks.


def enumeration() -> str:
    """Return speed, ids and texts as the kernel has read them."""
    with plugged_in():
        (folder,) = cameras_on_bus()
        values = [(folder / name).read_text().strip() for name in ("speed", "idVendor", "idProduct", "serial")]
        assert values == ["5000", "1e10", "3300", "4711"]
        classes = sorted(
            "/".join(
                (interface / f"bInterface{part}").read_text().strip() for part in ("Class", "SubClass", "Protocol")
            )
            for interface in folder.glob("*:1.*")
        )
        assert classes == ["ef/05/00", "ef/05/02"]
        return f"{values[0]} Mbit/s, {values[1]}:{values[2]}, serial {values[3]}, interfaces {' '.join(classes)}"


def aravis_features() -> str:
    """Return features as ``arv-tool`` prints them."""
    names = ("DeviceModelName", "DeviceID", "Width", "Height", "PayloadSize", "ExposureTime")
    with plugged_in():
        command = ["arv-tool-0.8", "control", "Width=640", "Height=240", *names]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
    values = dict(line.split(" = ", 1) for line in done.stdout.splitlines() if " = " in line)
    text = ", ".join(f"{name} {values[name].split(' min')[0]}" for name in names)
    assert int(values["PayloadSize"].split()[0]) == 640 * 240, done.stdout
    return text


def aravis_stream() -> str:
    """Stream with aravis, every pixel checked."""
    with plugged_in():
        camera, numbers = AravisCamera(), []
        with camera.streaming(SMALL, RATE_HZ) as read:
            for _ in range(FRAMES):
                status, number, pixels = read()
                assert status == 0, f"frame {number}: status {status}"
                assert (pixels == image(number, SMALL.shape)).all(), f"pixels of frame {number}"
                numbers.append(number)
        camera.close()
    gaps = {number: step - 1 for number, step in zip(numbers, np.diff(numbers), strict=False) if step != 1}
    assert not gaps, f"frames lost: {gaps}"
    return f"frames {numbers[0]} to {numbers[-1]}, every one with every pixel right"


def driver_stream() -> str:
    """Stream with this package's driver over libusb, every pixel checked."""
    with plugged_in(), opened() as camera:
        said = streamed(started(camera), FRAMES)
        assert not camera.dropped.keys() - {"invalid after a change"}, said
        return said


def late_and_lost_acknowledgements() -> str:
    """Open and configure where acknowledgements are pending, refused as busy, or lost."""
    with plugged_in():
        inject('{"pending_acks": 5, "busy_acks": 3, "lose_acks": 1}')
        with opened() as camera:
            return streamed(started(camera), 10)


def aravis_pending_acknowledgements() -> str:
    """Read a feature with aravis where acknowledgements are pending."""
    with plugged_in():
        inject('{"pending_acks": 5}')
        camera = AravisCamera()
        model = camera.text("DeviceModelName")
        camera.close()
        return model


def short_and_bad_frames() -> str:
    """Stream where frames are cut short, end with a bad trailer, or are missing."""
    with plugged_in(), opened() as camera:
        started(camera)
        streamed(camera, 5)
        for fault in ('{"short_frames": 2}', '{"bad_trailers": 1}', '{"drop_frames": 2}'):
            inject(fault)
            said = streamed(camera, 10)
        lost = {"short frame": 2, "bad trailer": 1, "gap": 2}
        assert {cause: camera.dropped.get(cause) for cause in lost} == lost, said
        return said


def halted_endpoints() -> str:
    """Stream where the endpoints halt once: the kernel and the camera clear the halt."""
    with plugged_in(), opened() as camera:
        inject('{"halt_control": 1}')
        started(camera)
        inject('{"halt_stream": 1}')
        return streamed(camera, 30)


def unplugging() -> str:
    """Unplug a camera that streams, and stream again from the one that is plugged in then."""
    with plugged_in() as unplug, opened() as camera:
        streamed(started(camera), 5)
        unplug()
        with refused("was unplugged") as said:
            streamed(camera, 100)
    with plugged_in(), opened() as camera:
        return f'"{said[0]}"; plugged in again: {streamed(started(camera), 5)}'


def high_speed() -> str:
    """Refuse a camera on a USB 2 link."""
    with plugged_in(HIGH_SPEED):
        (folder,) = cameras_on_bus()
        speed = (folder / "speed").read_text().strip()
        assert speed == "480"
        with refused("USB 2 link") as said:
            opened()
    return f'{speed} Mbit/s: "{said[0]}"'


def permission() -> str:
    """Refuse a camera whose device file this user may not open, with the udev rule."""
    with plugged_in():
        os.setegid(NOBODY)
        os.seteuid(NOBODY)
        try:
            with refused("no permission", "udev") as said:
                opened()
        finally:
            os.seteuid(0)
            os.setegid(0)
    return f'"{said[0]}"'


def two_programs() -> str:
    """Refuse a camera that another program has open."""
    with plugged_in(), other_program(stream_by_driver), refused("open in another program") as said:
        opened()
    return f'"{said[0]}"'


def killed_driver() -> str:
    """Stream from a camera that goes on streaming for a program of this package that was killed."""
    with plugged_in():
        with other_program(stream_by_driver):
            pass
        with opened() as camera:
            return streamed(started(camera), 10)


def killed_aravis() -> str:
    """Stream from a camera that goes on streaming for a program with aravis that was killed."""
    with plugged_in():
        with other_program(stream_by_aravis):
            pass
        with opened() as camera:
            return streamed(started(camera), 10)


def stream_by_driver() -> Iterator[None]:
    """Stream by this package's driver without end."""
    with opened() as camera:
        started(camera)
        while True:
            yield streamed(camera, 1)


def stream_by_aravis() -> Iterator[None]:
    """Stream by aravis without end."""
    with AravisCamera().streaming(SMALL, RATE_HZ) as read:
        while True:
            yield read()


@contextmanager
def other_program(stream: Callable[[], Iterator[None]]) -> Iterator[None]:
    """Run a process that streams; kill it at the end."""
    streams, begun = os.pipe()
    child = os.fork()
    if not child:
        with suppress(BaseException):
            for _ in stream():
                os.write(begun, b".")
        os._exit(1)
    os.close(begun)
    try:
        assert os.read(streams, 1) == b".", "the other program does not stream"
        yield
    finally:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)


CHECKS = {
    "the kernel enumerates it at SuperSpeed": enumeration,
    "aravis reads and writes its features": aravis_features,
    "aravis streams": aravis_stream,
    "the driver streams over libusb": driver_stream,
    "acknowledgements pending, busy, lost": late_and_lost_acknowledgements,
    "aravis, acknowledgements pending": aravis_pending_acknowledgements,
    "frames short, bad, missing": short_and_bad_frames,
    "endpoints halt": halted_endpoints,
    "unplugged while it streams, and plugged in again": unplugging,
    "plugged into USB 2": high_speed,
    "no permission": permission,
    "open in another program": two_programs,
    "the program that streamed was killed": killed_driver,
    "aravis was killed while it streamed": killed_aravis,
}


def held(name: str, check: Callable[[], str]) -> bool:
    """Run a check in a process of its own, and print its result."""
    begin_s = time.monotonic()
    child = os.fork()
    if not child:
        signal.alarm(LIMIT_S)
        try:
            print(f"ok      {name}: {check()} ({time.monotonic() - begin_s:.1f} s)", flush=True)
        except BaseException:  # noqa: BLE001 - printed, and the check fails
            print(f"FAILED  {name}\n{traceback.format_exc()}", flush=True)
            os._exit(1)
        os._exit(0)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if code < 0:
        print(f"FAILED  {name}: ended by signal {-code} after {time.monotonic() - begin_s:.0f} s", flush=True)
    return code == 0


def main() -> None:
    """Run all checks, or those whose names begin with the words of the command line."""
    print(f"Linux {os.uname().release}, Python {sys.version.split()[0]}", flush=True)
    chosen = {name: check for name, check in CHECKS.items() if name.startswith(tuple(sys.argv[2:]) or "")}
    count = sum(held(name, check) for name, check in chosen.items())
    print(f"{count} of {len(chosen)} checks passed", flush=True)


if __name__ == "__main__":
    main()
