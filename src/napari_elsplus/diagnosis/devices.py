"""Whether the camera and the galvo's card could be reached: the libraries and permissions under their drivers."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from napari_elsplus.diagnosis.finding import ok, warning

if TYPE_CHECKING:
    from collections.abc import Iterator

    from napari_elsplus.diagnosis.finding import Finding

CAMERA_VENDOR = 0x1E10
"""FLIR, formerly Point Grey."""
MENDS_LIBUSB = {
    "linux": "apt-get install libusb-1.0-0",
    "darwin": "brew install libusb",
    "win32": "put libusb-1.0.dll (from libusb.info) into a folder that is on PATH",
}
UDEV_RULE = f'SUBSYSTEM=="usb", ATTR{{idVendor}}=="{CAMERA_VENDOR:04x}", MODE="0666"'
MENDS_PERMISSION = (
    f"write the line {UDEV_RULE} to /etc/udev/rules.d/99-elsplus.rules, "
    "run `sudo udevadm control --reload && sudo udevadm trigger`, and plug the camera in again"
)
DEVICE_FILES = Path("/dev/bus/usb")


def usb() -> Iterator[Finding]:
    """See that the camera's bus can be reached, and that what hangs on it may be opened."""
    from usb import core
    from usb.backend import libusb1

    backend = libusb1.get_backend()
    if backend is None:
        remedy = MENDS_LIBUSB.get(sys.platform, "install libusb 1.0")
        yield warning("no libusb 1.0, so no USB camera can be reached", remedy)
        return
    cameras = list(core.find(find_all=True, backend=backend, idVendor=CAMERA_VENDOR))
    yield ok(f"libusb 1.0; {len(cameras)} USB device(s) of the camera's maker ({CAMERA_VENDOR:04x})")
    for camera in cameras:
        file = DEVICE_FILES / f"{camera.bus:03d}" / f"{camera.address:03d}"
        if file.exists() and not os.access(file, os.R_OK | os.W_OK):
            yield warning(f"no permission to open the camera at {file}", MENDS_PERMISSION)


def galvo_card() -> Iterator[Finding]:
    """See that NI's driver, which the galvo's card needs, is installed."""
    from nidaqmx.errors import Error
    from nidaqmx.system import System

    try:
        driver = System.local().driver_version
    except Error as error:
        reason = str(error).strip().partition(". ")[0]
        yield warning(
            f"no galvo card can be reached ({reason})", "install NI-DAQmx from ni.com; the simulated rig needs none"
        )
        return
    yield ok(f"NI-DAQmx {driver.major_version}.{driver.minor_version}")


CHECKS = (usb, galvo_card)
