"""Find USB3 Vision cameras by their device class, and name the reason why one cannot be used.

Cameras are not matched by product id: the same Flea3 has two, and with the older firmware it is no USB3 Vision camera.
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
"""USB class triple of devices with interface associations."""
USB3_VISION: Final = 0x05
"""Interface subclass."""
CONTROL, STREAM = 0x00, 0x02
"""Interface protocols of the control and the stream channel."""
VENDOR_CLASS: Final = 0xFF
"""Interface class of the older IIDC firmware."""
FLIR: Final = 0x1E10
"""USB vendor id of the Flea3's maker (FLIR, formerly Point Grey)."""
SPEED_SUPER: Final = 4
"""libusb's code of USB 3.0; smaller ones are slower links."""
UDEV_RULE: Final = f'SUBSYSTEM=="usb", ATTR{{idVendor}}=="{FLIR:04x}", MODE="0666"'
"""Rule by which Linux lets every user open cameras of that maker."""
PERMISSION_REMEDIES: Final = {
    "linux": f"write {UDEV_RULE} into /etc/udev/rules.d/99-elsplus.rules, run `sudo udevadm control --reload && "
    "sudo udevadm trigger`, plug it in again",
    "win32": "give it the WinUSB driver with Zadig (the maker's own viewer then stops working with it)",
}
"""Remedy where access to the camera is denied, by ``sys.platform``."""
UNPLUGGED: Final = (errno.ENODEV, errno.EIO, errno.ESHUTDOWN)
"""System errors of a device that is gone."""


@dataclass(frozen=True, slots=True)
class Endpoints:
    """Interfaces and endpoints of a USB3 Vision device's control and stream channels."""

    control_interface: int
    control_out: int
    control_in: int
    stream_interface: int
    stream_in: int


@contextmanager
def translate_usb_errors(what: str) -> Iterator[None]:
    """Turn pyusb's exceptions into a `DeviceError` with a remedy.

    Parameters
    ----------
    what : str
        Device or bus, as the message names it.

    Raises
    ------
    DeviceError
        For every error of the bus.
    """
    from usb.core import NoBackendError, USBError

    try:
        yield
    except NoBackendError as error:
        raise DeviceError("libusb is not installed, so no camera can be reached", "install libusb 1.0") from error
    except NotImplementedError as error:  # libusb's word on Windows for "another driver has it"
        raise DeviceError(f"{what} has no driver that libusb can use", PERMISSION_REMEDIES["win32"]) from error
    except USBError as error:
        if error.errno == errno.EACCES:
            remedy = PERMISSION_REMEDIES.get(sys.platform, "run it from an account that may use USB devices")
            raise DeviceError(f"no permission to open {what}", remedy) from error
        if error.errno == errno.EBUSY:
            raise DeviceError(f"{what} is open in another program", "close that program, then try again") from error
        if error.errno in UNPLUGGED:
            raise DeviceError(f"{what} was unplugged", "plug it in again, then open the rig again") from error
        if error.errno == errno.EPIPE:
            raise DeviceError(f"{what} has halted its endpoint", "open the rig again, which ends the halt") from error
        raise DeviceError(f"{what}: {error}", "plug it in again; if that does not help, try another port") from error


def libusb() -> IBackend | None:
    """Return libusb of the system, else that of the package ``libusb-package``; None where there is neither."""
    from usb.backend import libusb1

    backend = libusb1.get_backend()
    if backend is None:
        try:
            from libusb_package import find_library
        except ImportError:  # installed on Windows only
            return None
        backend = libusb1.get_backend(find_library=find_library)
    return backend


def find_cameras(backend: IBackend | None = None) -> list[Device]:
    """Return every USB3 Vision device on the bus.

    Parameters
    ----------
    backend : usb.backend.IBackend, optional
        Bus; libusb by default.

    Raises
    ------
    DeviceError
        If libusb is missing.
    """
    from usb import core

    with translate_usb_errors("the bus"):
        return [device for device in core.find(find_all=True, backend=backend or libusb()) if is_usb3_vision(device)]


def find_iidc(backend: IBackend | None = None) -> list[Device]:
    """Return cameras of the Flea3's maker whose firmware implements IIDC and not USB3 Vision.

    Parameters
    ----------
    backend : usb.backend.IBackend, optional
        Bus; libusb by default.
    """
    from usb import core

    with translate_usb_errors("the bus"):
        found = core.find(find_all=True, backend=backend or libusb(), idVendor=FLIR)
        return [d for d in found if not is_usb3_vision(d) and VENDOR_CLASS in {i[0] for i in _interface_classes(d)}]


def is_usb3_vision(device: Device) -> bool:
    """Return True if class and interfaces of a device are those of USB3 Vision."""
    classes = device.bDeviceClass, device.bDeviceSubClass, device.bDeviceProtocol
    return classes == (MISCELLANEOUS, COMMON, ASSOCIATION) and (MISCELLANEOUS, USB3_VISION, CONTROL) in (
        _interface_classes(device)
    )


def choose_camera(serial: str = "", backend: IBackend | None = None) -> Device:
    """Return the camera with a serial number, or the only one.

    Parameters
    ----------
    serial : str
        Empty where only one camera is connected.
    backend : usb.backend.IBackend, optional
        Bus; libusb by default.

    Raises
    ------
    DeviceError
        If there is none, or more than one to choose from, or the serial numbers cannot be read.
    """
    cameras = find_cameras(backend)
    if serial:
        numbers = [_serial_number(camera) for camera in cameras]
        if serial not in numbers:
            for unread in (number for number in numbers if isinstance(number, DeviceError)):
                raise unread
        cameras = [camera for camera, number in zip(cameras, numbers, strict=True) if number == serial]
    if len(cameras) == 1:
        return cameras[0]
    if cameras:
        raise DeviceError(f"{len(cameras)} cameras are connected", "write the serial of one into the rig's file")
    if find_iidc(backend):
        raise DeviceError(
            "the camera's firmware uses IIDC, not USB3 Vision", "update the firmware with the maker's software"
        )
    missing = f"no USB3 Vision camera with serial {serial}" if serial else "no USB3 Vision camera is connected"
    raise DeviceError(missing, "plug it into a USB 3 port, then see `napari-elsplus doctor`")


def refuse_slow_link(device: Device) -> None:
    """Refuse a camera `device` on a USB 2 link.

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
    """Return the endpoints of control and stream in the descriptors of a device.

    Raises
    ------
    DeviceError
        If one is missing.
    """
    with translate_usb_errors("the camera"):
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


def _serial_number(device: Device) -> str | DeviceError:
    """Return the serial number of a device, or why it cannot be read; empty where the device has none."""
    from usb.util import get_langids, get_string

    try:
        with translate_usb_errors("a camera whose serial number is needed"):
            languages = get_langids(device)  # not the device's own list, which is empty after any error
            return str(get_string(device, device.iSerialNumber, languages[0])) if languages else ""
    except DeviceError as error:
        return error
    except UnicodeDecodeError:
        return ""


def _interface_classes(device: Device) -> set[tuple[Any, Any, Any]]:
    return {
        (i.bInterfaceClass, i.bInterfaceSubClass, i.bInterfaceProtocol)
        for configuration in device
        for i in configuration
    }
