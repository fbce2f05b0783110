"""Finding USB3 Vision cameras by their class, and saying why one cannot be used.

The product id is never asked: the same Flea3 has two, and with the older firmware it is no USB3 Vision camera at all.
"""

from __future__ import annotations

import errno
import sys
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from napari_elsplus.errors import DeviceError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from usb.backend import IBackend
    from usb.core import Device

MISCELLANEOUS, COMMON, ASSOCIATION = 0xEF, 0x02, 0x01
USB3_VISION: Final = 0x05
CONTROL, STREAM = 0x00, 0x02
VENDOR_CLASS: Final = 0xFF
FLIR: Final = 0x1E10
SPEED_SUPER: Final = 4
UDEV_RULE: Final = f'SUBSYSTEM=="usb", ATTR{{idVendor}}=="{FLIR:04x}", MODE="0666"'
ALLOW: Final = {
    "linux": f"write {UDEV_RULE} into /etc/udev/rules.d/99-elsplus.rules, run `sudo udevadm control --reload && "
    "sudo udevadm trigger`, plug it in again",
    "win32": "give it the WinUSB driver with Zadig (the maker's own viewer then stops working with it)",
}
UNPLUGGED: Final = (errno.ENODEV, errno.EIO, errno.ESHUTDOWN, errno.EPIPE)


@dataclass(frozen=True, slots=True)
class Endpoints:
    """Where control and stream of a USB3 Vision device are."""

    control_interface: int
    control_out: int
    control_in: int
    stream_interface: int
    stream_in: int


@contextmanager
def told_by_usb(what: str) -> Iterator[None]:
    """Turn what pyusb raises into a `DeviceError` with a remedy; time-outs pass through.

    Raises
    ------
    DeviceError
        For every error of the bus but a time-out.
    """
    from usb.core import NoBackendError, USBError, USBTimeoutError

    try:
        yield
    except USBTimeoutError:
        raise
    except NoBackendError as error:
        raise DeviceError("libusb is not installed, so no camera can be reached", "install libusb 1.0") from error
    except NotImplementedError as error:  # libusb's word on Windows for "another driver has it"
        raise DeviceError(f"{what} has no driver that libusb can use", ALLOW["win32"]) from error
    except USBError as error:
        if error.errno == errno.EACCES:
            remedy = ALLOW.get(sys.platform, "run it from an account that may use USB devices")
            raise DeviceError(f"no permission to open {what}", remedy) from error
        if error.errno == errno.EBUSY:
            raise DeviceError(f"{what} is open in another program", "close that program, then try again") from error
        if error.errno in UNPLUGGED:
            raise DeviceError(f"{what} was unplugged", "plug it in again, then open the rig again") from error
        raise DeviceError(f"{what}: {error}", "plug it in again; if that does not help, try another port") from error


def find_cameras(backend: IBackend | None = None) -> list[Device]:
    """Return every USB3 Vision device on the bus.

    Raises
    ------
    DeviceError
        If libusb is missing.
    """
    from usb import core

    with told_by_usb("the bus"):
        return [device for device in core.find(find_all=True, backend=backend) if is_usb3_vision(device)]


def find_iidc(backend: IBackend | None = None) -> list[Device]:
    """Return cameras of the Flea3's maker whose firmware speaks IIDC and not USB3 Vision."""
    from usb import core

    with told_by_usb("the bus"):
        found = core.find(find_all=True, backend=backend, idVendor=FLIR)
        return [d for d in found if not is_usb3_vision(d) and VENDOR_CLASS in {i[0] for i in _interface_classes(d)}]


def is_usb3_vision(device: Device) -> bool:
    """Whether a device's class, and one of its interfaces, say USB3 Vision."""
    classes = device.bDeviceClass, device.bDeviceSubClass, device.bDeviceProtocol
    return classes == (MISCELLANEOUS, COMMON, ASSOCIATION) and (MISCELLANEOUS, USB3_VISION, CONTROL) in (
        _interface_classes(device)
    )


def choose_camera(serial: str = "", backend: IBackend | None = None) -> Device:
    """Return the camera with that serial number, or the only one.

    Raises
    ------
    DeviceError
        If there is none, or more than one to choose from.
    """
    cameras = find_cameras(backend)
    if serial:
        with told_by_usb("the camera"):
            cameras = [camera for camera in cameras if camera.serial_number == serial]
    if len(cameras) == 1:
        return cameras[0]
    if cameras:
        raise DeviceError(f"{len(cameras)} cameras are connected", "write the serial of one into the rig's file")
    if find_iidc(backend):
        raise DeviceError(
            "the camera's firmware speaks IIDC, not USB3 Vision", "update the firmware with the maker's software"
        )
    wanted = f"no USB3 Vision camera with serial {serial}" if serial else "no USB3 Vision camera is connected"
    raise DeviceError(wanted, "plug it into a USB 3 port, then see `napari-elsplus doctor`")


def refuse_slow_link(device: Device) -> None:
    """Refuse a camera on a USB 2 link.

    Raises
    ------
    DeviceError
        If the link is slower than USB 3.
    """
    if device.speed is not None and device.speed < SPEED_SUPER:
        raise DeviceError(
            "the camera is on a USB 2 link, far too slow for its frames",
            "use a blue (USB 3) port and the cable that came with it",
        )


def endpoints(device: Device) -> Endpoints:
    """Find the endpoints of control and stream in a device's descriptors.

    Raises
    ------
    DeviceError
        If one is missing.
    """
    with told_by_usb("the camera"):
        interfaces = {i.bInterfaceProtocol: i for i in device[0] if i.bInterfaceSubClass == USB3_VISION}
        pipes = {
            (protocol, e.bEndpointAddress >= 0x80): e.bEndpointAddress
            for protocol, i in interfaces.items()
            for e in i
        }  # fmt: skip
    try:
        return Endpoints(
            interfaces[CONTROL].bInterfaceNumber, pipes[CONTROL, False], pipes[CONTROL, True],
            interfaces[STREAM].bInterfaceNumber, pipes[STREAM, True],
        )  # fmt: skip
    except KeyError:
        raise DeviceError("the camera has no control or no stream endpoint", "update its firmware") from None


def _interface_classes(device: Device) -> set[tuple[Any, Any, Any]]:
    return {
        (i.bInterfaceClass, i.bInterfaceSubClass, i.bInterfaceProtocol)
        for configuration in device
        for i in configuration
    }
