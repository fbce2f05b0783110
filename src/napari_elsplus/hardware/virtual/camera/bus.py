"""A virtual USB bus: a pyusb backend with virtual cameras."""

from __future__ import annotations

import errno
import time
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from usb.backend import IBackend
from usb.core import USBError

from napari_elsplus.hardware.virtual.camera import descriptors
from napari_elsplus.hardware.virtual.camera.descriptors import CONTROL_IN, CONTROL_OUT, ENDPOINT, INTERFACE, STREAM_IN

if TYPE_CHECKING:
    from array import array
    from collections.abc import Iterator

    from napari_elsplus.hardware.virtual.camera.device import VirtualCamera


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
    forbidden, unplugged : bool
        Faults.
    """

    camera: VirtualCamera
    speed: int = 4
    iidc: bool = False
    forbidden: bool = False
    unplugged: bool = False
    interfaces: set[int] = field(default_factory=set)

    @property
    def is_super(self) -> bool:
        """The link is USB 3."""
        return self.speed >= 4


class VirtualBus(IBackend):  # type: ignore[misc] # pyusb has no types
    """The bus; its methods are those of `usb.backend.IBackend`.

    A camera does not notice that its program ends: what it was commanded goes on until it is commanded otherwise.

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
        (described,) = descriptors.parse(descriptors.device(dev.iidc, dev.is_super))
        place = {"address": 1 + self.plugs.index(dev), "bus": 1, "port_number": 1, "port_numbers": (1,)}
        return SimpleNamespace(**vars(described) | place, speed=dev.speed)

    def get_configuration_descriptor(self, dev: Plug, config: int) -> SimpleNamespace:
        """Describe the configuration; see :meth:`usb.backend.IBackend.get_configuration_descriptor`."""
        if config:
            raise IndexError(config)
        return next(descriptors.parse(descriptors.configuration(dev.iidc, dev.is_super)))

    def get_interface_descriptor(self, dev: Plug, intf: int, alt: int, config: int) -> SimpleNamespace:
        """Describe the control or the stream interface; see :meth:`usb.backend.IBackend.get_interface_descriptor`."""
        if alt or config:
            raise IndexError(alt or config)
        return _parts(dev, INTERFACE)[intf]

    def get_endpoint_descriptor(self, dev: Plug, ep: int, intf: int, alt: int, config: int) -> SimpleNamespace:
        """Describe an endpoint; see :meth:`usb.backend.IBackend.get_endpoint_descriptor`."""
        del alt, config
        return _parts(dev, ENDPOINT)[2 * intf + ep]

    def open_device(self, dev: Plug) -> Plug:
        """Open a device; see :meth:`usb.backend.IBackend.open_device`."""
        self._reach(dev)
        if dev.forbidden:
            raise USBError("Access denied (insufficient permissions)", -3, errno.EACCES)
        return dev

    def close_device(self, dev_handle: Plug) -> None:
        """Close a device; see :meth:`usb.backend.IBackend.close_device`."""

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
        if intf in dev_handle.interfaces:
            raise USBError("Resource busy", -6, errno.EBUSY)
        dev_handle.interfaces.add(intf)

    def release_interface(self, dev_handle: Plug, intf: int) -> None:
        """Release an interface; see :meth:`usb.backend.IBackend.release_interface`."""
        dev_handle.interfaces.discard(intf)

    def is_kernel_driver_active(self, dev_handle: Plug, intf: int) -> bool:
        """Return False: the system has no driver; see :meth:`usb.backend.IBackend.is_kernel_driver_active`."""
        del dev_handle, intf
        return False

    def clear_halt(self, dev_handle: Plug, ep: int) -> None:
        """End the halt of an endpoint; see :meth:`usb.backend.IBackend.clear_halt`."""
        self._reach(dev_handle)
        camera = dev_handle.camera
        (camera.stream_endpoint if ep == STREAM_IN else camera.control_endpoint).clear_halt()

    def ctrl_transfer(
        self, dev_handle: Plug, request_type: int, request: int, value: int, index: int, data: Any, timeout: int
    ) -> int:
        """Answer requests for texts; see :meth:`usb.backend.IBackend.ctrl_transfer`."""
        del request_type, request, index, timeout
        self._reach(dev_handle)
        packet = descriptors.string(value & 0xFF, dev_handle.camera.serial)[: len(data)]
        data[: len(packet)] = type(data)("B", packet)
        return len(packet)

    def bulk_write(self, dev_handle: Plug, ep: int, intf: int, data: array[int], timeout: int) -> int:
        """Execute a control command; see :meth:`usb.backend.IBackend.bulk_write`."""
        del intf, timeout
        self._reach(dev_handle)
        if ep != CONTROL_OUT:
            raise USBError("Entity not found", -5, errno.ENOENT)
        dev_handle.camera.control_endpoint.write(data.tobytes())
        return len(data)

    def bulk_read(self, dev_handle: Plug, ep: int, intf: int, buff: array[int], timeout: int) -> int:
        """Return an acknowledgement, or the next packets of the stream; see :meth:`usb.backend.IBackend.bulk_read`."""
        del intf
        self._reach(dev_handle)
        if ep == STREAM_IN:
            count = dev_handle.camera.read_stream(buff, timeout / 1000)
            self._reach(dev_handle)
            return count
        if ep == CONTROL_IN:
            answer = dev_handle.camera.control_endpoint.read(timeout / 1000)
            buff[: len(answer)] = type(buff)("B", answer)
            return len(answer)
        raise USBError("Entity not found", -5, errno.ENOENT)

    def _reach(self, plug: Plug) -> None:
        if plug.unplugged:
            time.sleep(1e-4)
            raise USBError("No such device (it may have been disconnected)", -4, errno.ENODEV)


def _parts(plug: Plug, kind: int) -> list[SimpleNamespace]:
    """Return the descriptors of a kind in a plug's configuration."""
    parts = descriptors.parse(descriptors.configuration(plug.iidc, plug.is_super))
    return [part for part in parts if part.bDescriptorType == kind]
