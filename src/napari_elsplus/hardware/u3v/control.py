"""The control channel: read and write the registers of a camera, with retries and a time limit."""

from __future__ import annotations

import errno
import struct
import threading
import time
from array import array
from typing import TYPE_CHECKING, Final

from napari_elsplus.errors import DeviceError
from napari_elsplus.hardware.u3v.discovery import translate_usb_errors
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
MODEL, SERIAL, MAX_RESPONSE_MS, MANIFEST, SBRM = 0x0044, 0x0144, 0x01CC, 0x01D0, 0x01D8
MAX_COMMAND, MAX_ACK, SIRM = 0x14, 0x18, 0x20

ACK_BYTES: Final = 1024
"""Bytes of the acknowledgement buffer; chosen: one packet of a USB 3 bulk endpoint."""
SAFE_PAYLOAD: Final = 64
"""Bytes that every device accepts in one command; its registers state how many more."""
MAX_PAYLOAD: Final = ACK_BYTES - HEADER.size - 8
"""Bytes read or written at once at most; derived from `ACK_BYTES`."""
TOP: Final = 1 << 64
"""End of the 64-bit address space."""
MAX_ATTEMPTS: Final = 3
"""Times that a command is sent; chosen: a single lost packet is made up for."""
TIMEOUT_MS: Final = 500
"""Milliseconds per transfer; chosen: far above the time of a register access, short for a person."""
FIRST_TIMEOUT_MS: Final = 2000
"""Milliseconds per transfer until the camera's own response time was read; chosen: longer than slow cameras state."""
BUSY: Final = 0x8007
"""GenCP status of a command to be sent again (EMVA GenCP 1.1, table 9)."""
BUSY_RETRY_S: Final = 0.02
"""Seconds before a command is sent again to a camera that was busy; chosen: some times that of a register access."""
PENDING_TIMEOUT_S: Final = 10.0
"""Seconds that a device may delay its answer by PENDING_ACK; chosen, longer than any region change."""
STATUS_WORDS: Final = {
    0x8001: "not implemented",
    0x8002: "invalid parameter",
    0x8003: "invalid address",
    0x8004: "write protected",
    0x8006: "access denied",
    BUSY: "busy",
    0x800B: "timed out",
}
"""GenCP status codes in words (EMVA GenCP 1.1, table 9)."""


class RegisterError(DeviceError):
    """Access to a register that the camera refused."""


class Control:
    """Registers of a USB3 Vision device.

    Parameters
    ----------
    device : usb.core.Device
        Open device.
    ends : Endpoints
        Its endpoints.

    Raises
    ------
    DeviceError
        If the device does not answer, or sends no valid acknowledgement.
    """

    def __init__(self, device: Device, ends: Endpoints) -> None:
        self._device, self._ends = device, ends
        self._lock = threading.Lock()
        self._request_id = time.monotonic_ns() & 0xFFFF  # not that of an answer which a killed program left unread
        self._timeout_ms = FIRST_TIMEOUT_MS
        self._answer = array("B", bytes(ACK_BYTES))
        self._read_payload = self._write_payload = SAFE_PAYLOAD
        self.sbrm = self.read_number(SBRM, 8)
        longest_ack = self.read_number(self.sbrm + MAX_ACK)
        longest_command = self.read_number(self.sbrm + MAX_COMMAND)
        self._read_payload = min(max(longest_ack - HEADER.size, SAFE_PAYLOAD), MAX_PAYLOAD) // 4 * 4
        self._write_payload = min(max(longest_command - HEADER.size - 8, SAFE_PAYLOAD), MAX_PAYLOAD) // 4 * 4
        self.sirm = self.read_number(self.sbrm + SIRM, 8)
        response_ms = min(self.read_number(MAX_RESPONSE_MS), int(PENDING_TIMEOUT_S * 1000))
        self._timeout_ms = TIMEOUT_MS + response_ms

    def read(self, address: int, count: int) -> bytes:
        """Read `count` bytes of memory from an `address` on.

        Raises
        ------
        DeviceError
            If the camera refuses, does not answer in time, or was unplugged.
        """
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
        """Write data to memory from an `address` on.

        Raises
        ------
        DeviceError
            As `read`.
        """
        for done in range(0, len(data), self._write_payload):
            self._exchange(CommandPacket.WRITE, address + done, data[done : done + self._write_payload])

    def read_number(self, address: int, size: int = 4) -> int:
        """Return the unsigned little-endian number of `size` bytes at an `address`."""
        return int.from_bytes(self.read(address, size), "little")

    def write_number(self, address: int, value: int) -> None:
        """Write a value as 32-bit unsigned number, little-endian, to an `address`."""
        self.write(address, struct.pack("<I", value))

    def read_float(self, address: int) -> float:
        """Return the 32-bit little-endian float at an `address`."""
        return float(struct.unpack("<f", self.read(address, 4))[0])

    def write_float(self, address: int, value: float) -> None:
        """Write a value as 32-bit little-endian float to an `address`."""
        self.write(address, struct.pack("<f", value))

    def read_text(self, address: int) -> str:
        """Return the text of the bootstrap registers at an `address`, 64 bytes at most."""
        return self.read(address, 64).split(b"\0")[0].decode("ascii", "replace").strip()

    def _exchange(self, command: CommandPacket, address: int, what: int | bytes) -> bytes:
        if address + (what if isinstance(what, int) else len(what)) > TOP:
            raise DeviceError(f"the camera points to {address:#x}, beyond its memory", "restart the camera")
        busy_until_s = time.monotonic() + PENDING_TIMEOUT_S
        unanswered = 0
        with self._lock, translate_usb_errors("the camera"):
            while unanswered < MAX_ATTEMPTS:
                ack = self._request(command, address, what)
                if ack is None:
                    unanswered += 1
                elif ack.status == BUSY and time.monotonic() < busy_until_s:
                    time.sleep(BUSY_RETRY_S)
                elif ack.status & 0x8000:
                    word = STATUS_WORDS.get(ack.status, f"status {ack.status:#06x}")
                    raise RegisterError(f"the camera refused register {address:#x}: {word}", "restart the camera")
                else:
                    return ack.data
        raise DeviceError(
            f"the camera did not answer {MAX_ATTEMPTS} times (register {address:#x})",
            "plug it in again, then open the rig again",
        )

    def _request(self, command: CommandPacket, address: int, what: int | bytes) -> Ack | None:
        """Send a command, and return its acknowledgement; None if none came, or the endpoint was halted."""
        from usb.core import USBError, USBTimeoutError

        self._request_id = self._request_id % 0xFFFF + 1
        request = (
            read_command(address, what, self._request_id)
            if isinstance(what, int)
            else write_command(address, what, self._request_id)
        )
        try:
            self._device.write(self._ends.control_out, request, self._timeout_ms)
            return self._await_answer(command)
        except (USBTimeoutError, PacketError):
            return None
        except USBError as error:
            if error.errno != errno.EPIPE:
                raise
            for endpoint in (self._ends.control_out, self._ends.control_in):
                self._device.clear_halt(endpoint)
            return None

    def _await_answer(self, command: CommandPacket) -> Ack:
        """Read until the answer to the last request comes; answers to older requests are passed over."""
        timeout_ms, until = self._timeout_ms, time.monotonic() + PENDING_TIMEOUT_S
        while time.monotonic() < until:
            count = self._device.read(self._ends.control_in, self._answer, timeout_ms)
            ack = parse_ack(self._answer[:count].tobytes())
            if ack.request_id != self._request_id:
                continue
            if ack.command == CommandPacket.PENDING_ACK:
                timeout_ms = min(pending_ms(ack) + self._timeout_ms, int(PENDING_TIMEOUT_S * 1000))
                continue
            if ack.command == command + 1:
                return ack
            raise PacketError(f"an answer {ack.command:#06x} to command {command:#06x}")
        raise PacketError("the camera kept asking for time")
