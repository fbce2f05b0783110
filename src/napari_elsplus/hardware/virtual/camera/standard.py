"""USB3 Vision and GenCP as a device implements them: packets, status codes and refusals, from the standards' text.

Nothing in this folder is imported from the drivers, so that a mistake in either shows between them. Sources: EMVA GenCP
1.1, sections on packet layout and status codes; AIA USB3 Vision 1.0.1, sections on control protocol and streaming.
"""

from __future__ import annotations

from struct import pack, unpack_from
from typing import Final

SUCCESS, NOT_IMPLEMENTED, INVALID_PARAMETER, INVALID_ADDRESS = 0x0000, 0x8001, 0x8002, 0x8003
WRITE_PROTECT, ACCESS_DENIED = 0x8004, 0x8006
"""GenCP 1.1, table of status codes."""
PAYLOAD_NOT_ALIGNED, STREAM_REGISTERS_INCONSISTENT, DATA_DISCARDED, DATA_OVERRUN = 0xA003, 0xA004, 0xA100, 0xA101
"""USB3 Vision 1.0.1, table of additional status codes."""
READ_MEMORY, WRITE_MEMORY = 0x0800, 0x0802
"""GenCP 1.1, table of command identifiers; an acknowledgement has the command's identifier plus one."""
ACKNOWLEDGE: Final = 0x4000
"""Bit of the command's flags that requests an acknowledgement (GenCP 1.1, common command data)."""
COMMAND_BYTES: Final = 12
"""Prefix of four bytes and common command data of eight (USB3 Vision 1.0.1, control packet prefix)."""
MONO8: Final = 0x0108_0001
"""Pixel Format Naming Convention: one component, 8 bits, number 1."""
IMAGE: Final = 0x0001
"""USB3 Vision 1.0.1, table of payload types."""
LEADER_BYTES, TRAILER_BYTES, CHUNK_TRAILER_BYTES = 52, 32, 36
"""USB3 Vision 1.0.1: image leader, image trailer, and the trailer of an image with chunks."""


class Refusal(Exception):
    """A command that the device refuses, with the status of its acknowledgement."""

    def __init__(self, status: int) -> None:
        super().__init__(f"{status:#06x}")
        self.status = status


def parse_command(packet: bytes) -> tuple[int, int, int, bytes]:
    """Return flags, command, request and data of a control `packet`.

    Raises
    ------
    ValueError
        If it is no USB3 Vision command, or its length contradicts its header.
    """
    if len(packet) < COMMAND_BYTES or packet[0:4] != bytes([0x55, 0x33, 0x56, 0x43]):  # "U3VC"
        raise ValueError(packet[:12].hex())
    flags, command, length, request = unpack_from("<4H", packet, 4)
    if length != len(packet) - COMMAND_BYTES:
        raise ValueError(f"{len(packet)} bytes of {length + COMMAND_BYTES}")
    return flags, command, request, packet[COMMAND_BYTES:]


def acknowledgement(status: int, command: int, request: int, data: bytes = b"") -> bytes:
    """Return the packet that acknowledges a request.

    Parameters
    ----------
    status : int
        GenCP status code.
    command : int
        Identifier of the acknowledgement.
    request : int
        Number of the request.
    data : bytes
        Its payload.
    """
    return bytes([0x55, 0x33, 0x56, 0x43]) + pack("<HHHH", status, command, len(data), request) + data


def leader(block: int, time_ns: int, region: tuple[int, int, int, int]) -> bytes:
    """Return the leader of an image.

    Parameters
    ----------
    block : int
        Number of the block.
    time_ns : int
        Timestamp.
    region : tuple of int
        Row, col, rows, cols.
    """
    row, col, rows, cols = region
    head = bytes([0x55, 0x33, 0x56, 0x4C]) + pack("<HHQHHQ", 0, LEADER_BYTES, block, 0, IMAGE, time_ns)  # "U3VL"
    return head + pack("<5I2H", MONO8, cols, rows, col, row, 0, 0)


def trailer(block: int, status: int, valid_bytes: int, rows: int) -> bytes:
    """Return the trailer of an image.

    Parameters
    ----------
    block : int
        Number of the block.
    status : int
        Status of the payload.
    valid_bytes : int
        Bytes of the payload that were sent.
    rows : int
        Lines of the image.
    """
    return bytes([0x55, 0x33, 0x56, 0x54]) + pack(  # "U3VT"
        "<HHQHHQI", 0, TRAILER_BYTES, block, status, 0, valid_bytes, rows
    )
