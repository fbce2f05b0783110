"""Record of what passes over the virtual bus, in the format of Linux's usbmon, which Wireshark reads."""

from __future__ import annotations

import struct
import threading
import time
from typing import TYPE_CHECKING, Final

from napari_elsplus.closing import ClosedOnExit
from napari_elsplus.hardware.virtual.camera import descriptors
from napari_elsplus.hardware.virtual.camera.bus import Plug, VirtualBus

if TYPE_CHECKING:
    from array import array
    from pathlib import Path

LINK_TYPE: Final = 220
"""LINKTYPE_USB_LINUX_MMAPPED: packets begin with a header of 64 bytes."""
CONTROL, BULK = 2, 3
"""Transfer types of usbmon."""
IN: Final = 0x80
"""Bit of an endpoint's address: towards the host."""
HEADER: Final = struct.Struct("<QcBBBHccqiiII8siiII")
KEPT: Final = 2048
"""Bytes of a transfer that are written; chosen: leaders, trailers and control packets are whole, images are cut."""


class Capture(ClosedOnExit):
    """A capture file; a context manager.

    Parameters
    ----------
    path : Path
        File, which is overwritten.
    """

    def __init__(self, path: Path) -> None:
        self._file, self._lock, self._number = path.open("wb"), threading.Lock(), 0
        self._file.write(struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 1 << 18, LINK_TYPE))

    def enumeration(self, device: bytes, configuration: bytes) -> None:
        """Record how a host reads the descriptors of device and configuration, by which Wireshark finds the class."""
        for kind, data in ((1, device), (2, configuration)):
            setup = struct.pack("<BBHHH", IN, 6, kind << 8, 0, len(data))
            self._transfer(CONTROL, IN, b"", data, setup, len(data))

    def bulk(self, endpoint: int, data: bytes, room: int = 0) -> None:
        """Record a bulk transfer.

        Parameters
        ----------
        endpoint : int
            Address.
        data : bytes
            What was written, or came.
        room : int
            Bytes that were asked for.
        """
        towards_host = bool(endpoint & IN)
        self._transfer(BULK, endpoint, b"" if towards_host else data, data if towards_host else b"", None, room)

    def close(self) -> None:
        """Close the file."""
        with self._lock:
            self._file.close()

    def _transfer(self, kind: int, endpoint: int, out: bytes, into: bytes, setup: bytes | None, room: int) -> None:
        """Record submission and completion of a transfer."""
        with self._lock:
            if self._file.closed:
                return
            self._number += 1
            self._packet(b"S", kind, endpoint, out, setup, max(room, len(out)), -115)
            self._packet(b"C", kind, endpoint, into, None, max(len(into), len(out)), 0)

    def _packet(
        self, event: bytes, kind: int, endpoint: int, data: bytes, setup: bytes | None, length: int, status: int
    ) -> None:
        now_ns = time.time_ns()
        kept = data[:KEPT]
        absent = b"<" if endpoint & IN else b">"
        header = HEADER.pack(
            self._number, event, kind, endpoint, 2, 1, b"-" if setup is None else b"\0", b"\0" if data else absent,
            now_ns // 10**9, now_ns // 1000 % 10**6, status, length, len(kept), setup or bytes(8), 0, 0, 0x200, 0,
        )  # fmt: skip
        record = struct.pack("<IIII", now_ns // 10**9, now_ns // 1000 % 10**6, 64 + len(kept), 64 + len(data))
        self._file.write(record + header + kept)


class CapturedBus(VirtualBus):
    """A virtual bus all of whose transfers are recorded.

    Parameters
    ----------
    plug : Plug
        Device on the bus.
    capture : Capture
        Receives every transfer.
    """

    def __init__(self, plug: Plug, capture: Capture) -> None:
        super().__init__(plug)
        self._capture = capture

    def open_device(self, dev: Plug) -> Plug:
        opened = super().open_device(dev)
        self._capture.enumeration(
            descriptors.device(dev.iidc, dev.is_super), descriptors.configuration(dev.iidc, dev.is_super)
        )
        return opened

    def bulk_write(self, dev_handle: Plug, ep: int, intf: int, data: array[int], timeout: int) -> int:
        self._capture.bulk(ep, data.tobytes())
        return super().bulk_write(dev_handle, ep, intf, data, timeout)

    def bulk_read(self, dev_handle: Plug, ep: int, intf: int, buff: array[int], timeout: int) -> int:
        count = super().bulk_read(dev_handle, ep, intf, buff, timeout)
        self._capture.bulk(ep, buff[:count].tobytes(), len(buff))
        return count
