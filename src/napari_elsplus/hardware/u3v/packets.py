"""USB3 Vision packets, to and from bytes.

Packets of a device are parsed by fixed-size structures with their lengths checked; anything else raises
`PacketError`. AIA USB3 Vision 1.0, tables 4-2 to 5-6; EMVA GenCP 1.1.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

COMMAND_MAGIC, LEADER_MAGIC, TRAILER_MAGIC = b"U3VC", b"U3VL", b"U3VT"
"""First four bytes of control packets, leaders and trailers."""
REQUEST_ACK: Final = 0x4000
"""Flag of a command that is acknowledged."""
IMAGE, IMAGE_WITH_CHUNKS = 0x0001, 0x4001
"""Payload types of an image leader: the image alone, or chunk data behind it."""
MONO8: Final = 0x01080001
"""Pixel format code (PFNC) of 8-bit grey levels."""
HEADER: Final = struct.Struct("<4sHHHH")
READ: Final = struct.Struct("<QHH")
PENDING: Final = struct.Struct("<HH")
LEADER: Final = struct.Struct("<4sHHQHHQIIIIIHH")
TRAILER: Final = struct.Struct("<4sHHQHHQI")
"""Packet layouts, little-endian."""


class CommandPacket(IntEnum):
    """Control commands; an acknowledgement has the next number."""

    READ = 0x0800
    WRITE = 0x0802
    PENDING_ACK = 0x0805


class PacketError(ValueError):
    """Bytes that are no packet of the kind expected."""


@dataclass(frozen=True, slots=True)
class Ack:
    """Acknowledgement: status, command acknowledged, and payload."""

    status: int
    command: int
    request_id: int
    data: bytes


@dataclass(frozen=True, slots=True)
class Leader:
    """Leader of a frame."""

    block_id: int
    timestamp: int
    """Ticks of the camera's clock; 1 ns by the standard."""
    pixel_format: int
    rows: int
    cols: int
    row: int
    col: int
    padding_x: int
    """Bytes after each line."""
    payload_type: int


@dataclass(frozen=True, slots=True)
class Trailer:
    """Trailer of a frame, with its status and number of valid bytes."""

    block_id: int
    status: int
    valid_bytes: int


def read_command(address: int, count: int, request_id: int) -> bytes:
    """Return the packet that requests memory.

    Parameters
    ----------
    address : int
        First byte.
    count : int
        Bytes.
    request_id : int
        16 bit, repeated in the acknowledgement.
    """
    return (
        HEADER.pack(COMMAND_MAGIC, REQUEST_ACK, CommandPacket.READ, READ.size, request_id)
        + READ.pack(address, 0, count)
    )  # fmt: skip


def write_command(address: int, data: bytes, request_id: int) -> bytes:
    """Return the packet that writes memory.

    Parameters
    ----------
    address : int
        First byte.
    data : bytes
        What is written.
    request_id : int
        16 bit, repeated in the acknowledgement.
    """
    return (
        HEADER.pack(COMMAND_MAGIC, REQUEST_ACK, CommandPacket.WRITE, 8 + len(data), request_id)
        + struct.pack("<Q", address) + data
    )  # fmt: skip


def parse_ack(packet: bytes) -> Ack:
    """Parse a packet as an acknowledgement.

    Raises
    ------
    PacketError
        If it is none, or shorter than its header states.
    """
    if len(packet) < HEADER.size:
        raise PacketError(f"an acknowledgement of {len(packet)} bytes")
    magic, status, command, length, request_id = HEADER.unpack_from(packet)
    data = packet[HEADER.size : HEADER.size + length]
    if magic != COMMAND_MAGIC or len(data) != length:
        raise PacketError(f"an acknowledgement that begins with {packet[:12].hex()}")
    return Ack(status, command, request_id, data)


def pending_ms(ack: Ack) -> int:
    """Return the waiting time in milliseconds that a PENDING_ACK `ack` requests.

    Raises
    ------
    PacketError
        If the packet is too short.
    """
    if len(ack.data) < PENDING.size:
        raise PacketError(f"a PENDING_ACK with {len(ack.data)} bytes")
    return int(PENDING.unpack_from(ack.data)[1])


def parse_leader(packet: bytes) -> Leader:
    """Parse a packet as the leader of an image.

    Raises
    ------
    PacketError
        If it is none.
    """
    if len(packet) < LEADER.size or packet[:4] != LEADER_MAGIC:
        raise PacketError(f"{len(packet)} bytes that are no leader: {packet[:8].hex()}")
    _, _, _, block, _, kind, time, pixel, cols, rows, col, row, padding_x, _ = LEADER.unpack_from(packet)
    if kind not in (IMAGE, IMAGE_WITH_CHUNKS):
        raise PacketError(f"a leader of payload type {kind:#06x}")
    return Leader(block, time, pixel, rows, cols, row, col, padding_x, kind)


def parse_trailer(packet: bytes) -> Trailer:
    """Parse a packet as the trailer of an image.

    Raises
    ------
    PacketError
        If it is none.
    """
    if len(packet) < TRAILER.size or packet[:4] != TRAILER_MAGIC:
        raise PacketError(f"{len(packet)} bytes that are no trailer: {packet[:8].hex()}")
    _, _, _, block, status, _, valid, _ = TRAILER.unpack_from(packet)
    return Trailer(block, status, valid)
