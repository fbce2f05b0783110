"""Checks of cameras, cards and rig files."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from napari_elsplus.diagnosis.finding import Finding, ok, warning
from napari_elsplus.errors import DeviceError, InputError
from napari_elsplus.hardware.rig_files import read_rig, rig_files, rig_folder
from napari_elsplus.hardware.u3v.discovery import (
    FLIR,
    PERMISSION_REMEDIES,
    find_cameras,
    find_iidc,
    libusb,
    refuse_slow_link,
    translate_usb_errors,
)

if TYPE_CHECKING:
    from collections.abc import Iterator


LIBUSB_REMEDIES: Final = {
    "linux": "apt-get install libusb-1.0-0",
    "darwin": "brew install libusb",
    "win32": "pip install libusb-package",
}
"""Remedy where libusb is absent, by ``sys.platform``."""
DEVICE_FILES = Path("/dev/bus/usb")
"""Device files of USB on Linux."""


def usb() -> Iterator[Finding]:
    """Check that libusb reaches the bus, and that the cameras on it may be opened and are fast enough."""
    backend = libusb()
    if backend is None:
        remedy = LIBUSB_REMEDIES.get(sys.platform, "install libusb 1.0")
        yield warning("no libusb 1.0, so no USB camera can be reached", remedy)
        return
    try:
        cameras, old = find_cameras(backend), find_iidc(backend)
    except DeviceError as error:
        yield warning(error.problem, error.remedy)
        return
    yield ok(f"libusb 1.0; {len(cameras)} USB3 Vision camera(s)")
    for camera in cameras:
        yield _camera(camera)
    for camera in old:
        yield warning(
            f"camera {_ids(camera)} uses IIDC, not USB3 Vision", "update its firmware with the maker's software"
        )


def _camera(camera: Any) -> Finding:
    """Return name and serial number of a camera, or the reason why it cannot be used."""
    file = DEVICE_FILES / f"{camera.bus:03d}" / f"{camera.address:03d}"
    if file.exists() and not os.access(file, os.R_OK | os.W_OK):
        return warning(f"no permission to open the camera at {file}", _allowing(camera))
    try:
        with translate_usb_errors(f"camera {_ids(camera)}"):
            name = f"{camera.manufacturer} {camera.product}, serial {camera.serial_number} ({_ids(camera)})"
        refuse_slow_link(camera)
    except DeviceError as error:
        return warning(error.problem, error.remedy)
    except ValueError:  # pyusb's word for texts that may not be read
        return warning(f"camera {_ids(camera)} may not be opened", _allowing(camera))
    return ok(name)


def _ids(camera: Any) -> str:
    return f"{camera.idVendor:04x}:{camera.idProduct:04x}"


def _allowing(camera: Any) -> str:
    """Return the remedy for missing permission, with the camera's own vendor id."""
    how = PERMISSION_REMEDIES.get(sys.platform, PERMISSION_REMEDIES["linux"])
    return how.replace(f"{FLIR:04x}", f"{camera.idVendor:04x}")


def galvo_card() -> Iterator[Finding]:
    """Check that NI's driver is installed, and list its cards."""
    from nidaqmx.errors import Error
    from nidaqmx.system import System

    try:
        system = System.local()
        driver = system.driver_version
        cards = [f"{device.name} ({device.product_type})" for device in system.devices]
    except Error as error:
        reason = str(error).strip().partition(". ")[0]
        yield warning(
            f"no galvo card can be reached ({reason})", "install NI-DAQmx from ni.com; the simulated rig needs none"
        )
        return
    yield ok(f"NI-DAQmx {driver.major_version}.{driver.minor_version}; cards: {', '.join(cards) or 'none'}")
    if not cards:
        yield warning("NI's driver lists no card", "plug it in and see that NI MAX shows it")


def rigs() -> Iterator[Finding]:
    """Check that every rig file can be read."""
    files = rig_files()
    yield ok(f"rigs: {', '.join(['simulated', *sorted(files)])} (files in {rig_folder()})")
    for name in sorted(files):
        try:
            read_rig(name)
        except InputError as error:
            yield warning(error.problem, error.remedy)


CHECKS = (usb, galvo_card, rigs)
"""Checks of this module, in order."""
