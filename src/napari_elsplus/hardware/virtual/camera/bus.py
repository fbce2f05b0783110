"""A virtual USB bus: a pyusb backend with virtual cameras."""

from __future__ import annotations

import errno
import time
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, Final

from usb.backend import IBackend
from usb.core import USBError

from napari_elsplus.hardware.u3v.discovery import ASSOCIATION, COMMON, FLIR, MISCELLANEOUS, USB3_VISION, VENDOR_CLASS

if TYPE_CHECKING:
    from array import array
    from collections.abc import Iterator

    from napari_elsplus.hardware.virtual.camera.device import VirtualCamera

CONTROL_OUT, CONTROL_IN, STREAM_IN = 0x01, 0x81, 0x82
"""Endpoint addresses."""
BULK: Final = 2
"""Transfer type."""
PACKET: Final = 1024
"""Bytes of a USB 3 bulk packet."""
STRINGS: Final = ("", "napari-elsplus", "virtual camera")
"""String descriptors: language, maker, product; the serial number follows."""


@dataclass
class Plug:
    """A device on the bus, and its faults.

    Parameters
    ----------
    camera : VirtualCamera
        The device.
    speed : int
        4: USB 3; 3: USB 2.
    iidc : bool
        It has the old firmware, which is not USB3 Vision.
    forbidden, busy, unplugged : bool
        Faults.
    """

    camera: VirtualCamera
    speed: int = 4
    iidc: bool = False
    forbidden: bool = False
    busy: bool = False
    unplugged: bool = False
    interfaces: set[int] = field(default_factory=set)


class VirtualBus(IBackend):  # type: ignore[misc] # pyusb has no types
    """The bus; its methods are those of `usb.backend.IBackend`.

    Parameters
    ----------
    *plugs : Plug
        Devices on the bus.
    """

    def __init__(self, *plugs: Plug) -> None:
        self.plugs = list(plugs)

    def enumerate_devices(self) -> Iterator[Plug]:
        """Return every device that is plugged in; see :meth:`usb.backend.IBackend.enumerate_devices`."""
        return iter([plug for plug in self.plugs if not plug.unplugged])

    def get_device_descriptor(self, dev: Plug) -> SimpleNamespace:
        """Describe a device; see :meth:`usb.backend.IBackend.get_device_descriptor`."""
        device, sub, protocol = (0, 0, 0) if dev.iidc else (MISCELLANEOUS, COMMON, ASSOCIATION)
        return SimpleNamespace(
            bLength=18, bDescriptorType=1, bcdUSB=0x0300, bDeviceClass=device, bDeviceSubClass=sub,
            bDeviceProtocol=protocol, bMaxPacketSize0=9, idVendor=FLIR, idProduct=0x3006 if dev.iidc else 0x3300,
            bcdDevice=1, iManufacturer=1, iProduct=2, iSerialNumber=3, bNumConfigurations=1,
            address=1 + self.plugs.index(dev), bus=1, port_number=1, port_numbers=(1,), speed=dev.speed,
        )  # fmt: skip

    def get_configuration_descriptor(self, dev: Plug, config: int) -> SimpleNamespace:
        """Describe the configuration; see :meth:`usb.backend.IBackend.get_configuration_descriptor`."""
        if config:
            raise IndexError(config)
        return SimpleNamespace(
            bLength=9, bDescriptorType=2, wTotalLength=0, bNumInterfaces=1 if dev.iidc else 2, bConfigurationValue=1,
            iConfiguration=0, bmAttributes=0x80, bMaxPower=112, extra_descriptors=[],
        )  # fmt: skip

    def get_interface_descriptor(self, dev: Plug, intf: int, alt: int, config: int) -> SimpleNamespace:
        """Describe the control or the stream interface; see :meth:`usb.backend.IBackend.get_interface_descriptor`."""
        if alt or config or intf > 1:
            raise IndexError(intf)
        kind, sub, protocol = (VENDOR_CLASS, 0, 0) if dev.iidc else (MISCELLANEOUS, USB3_VISION, 2 * intf)
        return SimpleNamespace(
            bLength=9, bDescriptorType=4, bInterfaceNumber=intf, bAlternateSetting=0, bNumEndpoints=1 if intf else 2,
            bInterfaceClass=kind, bInterfaceSubClass=sub, bInterfaceProtocol=protocol, iInterface=0,
            extra_descriptors=[],
        )  # fmt: skip

    def get_endpoint_descriptor(self, dev: Plug, ep: int, intf: int, alt: int, config: int) -> SimpleNamespace:
        """Describe an endpoint; see :meth:`usb.backend.IBackend.get_endpoint_descriptor`."""
        del dev, alt, config
        address = STREAM_IN if intf else (CONTROL_OUT, CONTROL_IN)[ep]
        return SimpleNamespace(
            bLength=7, bDescriptorType=5, bEndpointAddress=address, bmAttributes=BULK, wMaxPacketSize=PACKET,
            bInterval=0, bRefresh=0, bSynchAddress=0, extra_descriptors=[],
        )  # fmt: skip

    def open_device(self, dev: Plug) -> Plug:
        """Open a device; see :meth:`usb.backend.IBackend.open_device`."""
        self._reach(dev)
        if dev.forbidden:
            raise USBError("Access denied (insufficient permissions)", -3, errno.EACCES)
        return dev

    def close_device(self, dev_handle: Plug) -> None:
        """Close a device; a camera that loses its host stops; see :meth:`usb.backend.IBackend.close_device`."""
        dev_handle.camera.close()

    def get_configuration(self, dev_handle: Plug) -> int:
        """Return the active configuration; see :meth:`usb.backend.IBackend.get_configuration`."""
        self._reach(dev_handle)
        return 1

    def set_configuration(self, dev_handle: Plug, config_value: int) -> None:
        """Set the only configuration; see :meth:`usb.backend.IBackend.set_configuration`."""
        del config_value
        self._reach(dev_handle)

    def set_interface_altsetting(self, dev_handle: Plug, intf: int, altsetting: int) -> None:
        """Set the only setting; see :meth:`usb.backend.IBackend.set_interface_altsetting`."""
        del intf, altsetting
        self._reach(dev_handle)

    def claim_interface(self, dev_handle: Plug, intf: int) -> None:
        """Claim an interface; see :meth:`usb.backend.IBackend.claim_interface`."""
        self._reach(dev_handle)
        if dev_handle.busy or intf in dev_handle.interfaces:
            raise USBError("Resource busy", -6, errno.EBUSY)
        dev_handle.interfaces.add(intf)

    def release_interface(self, dev_handle: Plug, intf: int) -> None:
        """Release an interface; see :meth:`usb.backend.IBackend.release_interface`."""
        dev_handle.interfaces.discard(intf)

    def is_kernel_driver_active(self, dev_handle: Plug, intf: int) -> bool:
        """Return False: the system has no driver; see :meth:`usb.backend.IBackend.is_kernel_driver_active`."""
        del dev_handle, intf
        return False

    def ctrl_transfer(
        self, dev_handle: Plug, request_type: int, request: int, value: int, index: int, data: Any, timeout: int
    ) -> int:
        """Answer requests for texts; see :meth:`usb.backend.IBackend.ctrl_transfer`."""
        del request_type, request, index, timeout
        self._reach(dev_handle)
        text = value & 0xFF
        body = b"\x09\x04" if text == 0 else (*STRINGS, dev_handle.camera.serial)[text].encode("utf-16-le")
        packet = (bytes([2 + len(body), 3]) + body)[: len(data)]
        data[: len(packet)] = type(data)("B", packet)
        return len(packet)

    def bulk_write(self, dev_handle: Plug, ep: int, intf: int, data: array[int], timeout: int) -> int:
        """Execute a control command; see :meth:`usb.backend.IBackend.bulk_write`."""
        del ep, intf, timeout
        self._reach(dev_handle)
        dev_handle.camera.command(data.tobytes())
        return len(data)

    def bulk_read(self, dev_handle: Plug, ep: int, intf: int, buff: array[int], timeout: int) -> int:
        """Return an acknowledgement, or the next packet of the stream; see :meth:`usb.backend.IBackend.bulk_read`."""
        del intf
        self._reach(dev_handle)
        if ep == STREAM_IN:
            count = dev_handle.camera.stream_into(buff, timeout / 1000)
            self._reach(dev_handle)
            return count
        answer = dev_handle.camera.answer(timeout / 1000)
        buff[: len(answer)] = type(buff)("B", answer)
        return len(answer)

    def _reach(self, plug: Plug) -> None:
        if plug.unplugged:
            time.sleep(1e-4)
            raise USBError("No such device (it may have been disconnected)", -4, errno.ENODEV)
