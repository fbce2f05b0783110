"""The control channel: reading and writing a camera's registers, patiently but not for ever."""

from __future__ import annotations

import struct
import threading
import time
from array import array
from typing import TYPE_CHECKING, Final

from napari_elsplus.errors import DeviceError
from napari_elsplus.hardware.u3v.discovery import told_by_usb
from napari_elsplus.hardware.u3v.packets import (
    HEADER,
    Ack,
    CommandPacket,
    PacketError,
    parse_ack,
    pending_ms,
    read_command,
    write_command,
)

if TYPE_CHECKING:
    from usb.core import Device

    from napari_elsplus.hardware.u3v.discovery import Endpoints

# Bootstrap registers (GenCP 1.1, table 23; USB3 Vision 1.0, tables 4-17 and 4-19).
MODEL, SERIAL, MANIFEST, SBRM = 0x0044, 0x0144, 0x01D0, 0x01D8
MAX_COMMAND, MAX_ACK, SIRM = 0x14, 0x18, 0x20

ACK_BYTES: Final = 1024
SAFE_PAYLOAD: Final = 64
"""Every device takes so much in one command; how much more, it says itself."""
MAX_PAYLOAD: Final = ACK_BYTES - HEADER.size - 8
TOP: Final = 1 << 64
TRIES: Final = 3
TIMEOUT_MS: Final = 500
PATIENCE_S: Final = 10.0
"""A device may ask for time with PENDING_ACK, but not for more than this."""
STATUS_WORDS: Final = {
    0x8001: "not implemented",
    0x8002: "invalid parameter",
    0x8003: "invalid address",
    0x8004: "write protected",
    0x8006: "access denied",
    0x8007: "busy",
    0x800B: "timed out",
}


class RegisterError(DeviceError):
    """The camera refused a register."""


class Control:
    """Registers of a USB3 Vision device.

    Parameters
    ----------
    device : usb.core.Device
        The device, opened.
    ends : Endpoints
        Its endpoints.

    Raises
    ------
    DeviceError
        If the device does not answer, or answers nonsense.
    """

    def __init__(self, device: Device, ends: Endpoints) -> None:
        self._device, self._ends = device, ends
        self._lock = threading.Lock()
        self._request_id = 0
        self._answer = array("B", bytes(ACK_BYTES))
        self._read_payload = self._write_payload = SAFE_PAYLOAD
        self.sbrm = self.read_number(SBRM, 8)
        longest_ack = self.read_number(self.sbrm + MAX_ACK)
        longest_command = self.read_number(self.sbrm + MAX_COMMAND)
        self._read_payload = min(max(longest_ack - HEADER.size, SAFE_PAYLOAD), MAX_PAYLOAD) // 4 * 4
        self._write_payload = min(max(longest_command - HEADER.size - 8, SAFE_PAYLOAD), MAX_PAYLOAD) // 4 * 4
        self.sirm = self.read_number(self.sbrm + SIRM, 8)

    def read(self, address: int, count: int) -> bytes:
        """Read memory.

        Raises
        ------
        DeviceError
            If the camera refuses, does not answer in time, or was unplugged.
        """
        if address + count > TOP:
            raise DeviceError(f"the camera points to {address:#x}, beyond its memory", "restart the camera")
        parts = []
        for done in range(0, count, self._read_payload):
            part = min(self._read_payload, count - done)
            data = self._exchange(CommandPacket.READ, address + done, part)
            if len(data) != part:
                raise DeviceError(
                    f"the camera sent {len(data)} of {part} bytes at {address + done:#x}", "restart the camera"
                )
            parts.append(data)
        return b"".join(parts)

    def write(self, address: int, data: bytes) -> None:
        """Write memory.

        Raises
        ------
        DeviceError
            As `read`.
        """
        for done in range(0, len(data), self._write_payload):
            self._exchange(CommandPacket.WRITE, address + done, data[done : done + self._write_payload])

    def read_number(self, address: int, size: int = 4) -> int:
        """Read an unsigned number, little-endian."""
        return int.from_bytes(self.read(address, size), "little")

    def write_number(self, address: int, value: int) -> None:
        """Write a 32-bit unsigned number, little-endian."""
        self.write(address, struct.pack("<I", value))

    def read_float(self, address: int) -> float:
        """Read a 32-bit float, little-endian."""
        return float(struct.unpack("<f", self.read(address, 4))[0])

    def write_float(self, address: int, value: float) -> None:
        """Write a 32-bit float, little-endian."""
        self.write(address, struct.pack("<f", value))

    def read_text(self, address: int) -> str:
        """Read one of the bootstrap's texts."""
        return self.read(address, 64).split(b"\0")[0].decode("ascii", "replace").strip()

    def _exchange(self, command: CommandPacket, address: int, what: int | bytes) -> bytes:
        from usb.core import USBTimeoutError

        with self._lock, told_by_usb("the camera"):
            for _ in range(TRIES):
                self._request_id = self._request_id % 0xFFFF + 1
                request = (
                    read_command(address, what, self._request_id)
                    if isinstance(what, int)
                    else write_command(address, what, self._request_id)
                )
                try:
                    self._device.write(self._ends.control_out, request, TIMEOUT_MS)
                    ack = self._await_answer(command)
                except (USBTimeoutError, PacketError):
                    continue
                if ack.status & 0x8000:
                    word = STATUS_WORDS.get(ack.status, f"status {ack.status:#06x}")
                    raise RegisterError(f"the camera refused register {address:#x}: {word}", "restart the camera")
                return ack.data
        raise DeviceError(
            f"the camera did not answer {TRIES} times (register {address:#x})",
            "plug it in again, then open the rig again",
        )

    def _await_answer(self, command: CommandPacket) -> Ack:
        """Read until the answer to the last request comes; answers to older requests are passed over."""
        timeout_ms, until = TIMEOUT_MS, time.monotonic() + PATIENCE_S
        while time.monotonic() < until:
            count = self._device.read(self._ends.control_in, self._answer, timeout_ms)
            ack = parse_ack(self._answer[:count].tobytes())
            if ack.request_id != self._request_id:
                continue
            if ack.command == CommandPacket.PENDING_ACK:
                timeout_ms = min(pending_ms(ack) + TIMEOUT_MS, int(PATIENCE_S * 1000))
                continue
            if ack.command == command + 1:
                return ack
            raise PacketError(f"an answer {ack.command:#06x} to command {command:#06x}")
        raise PacketError("the camera kept asking for time")
