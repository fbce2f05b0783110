"""The virtual camera's memory: bootstrap registers, the Flea3's registers, and this package's own description."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Final

from napari_elsplus.hardware.u3v import control, flea3, stream
from napari_elsplus.hardware.virtual.camera.description import describe
from napari_elsplus.instrument.optics import SENSOR_SHAPE

if TYPE_CHECKING:
    from collections.abc import Iterator

SBRM, SIRM, MANIFEST, XML = 0x1_0000, 0x2_0000, 0x3_0000, 0x4_0000
"""Addresses of the register blocks; arbitrary."""
STROBE: Final = flea3.BASE + 0x5000
"""Address of the strobe registers; arbitrary."""
REGISTERS: Final = 0x6000
"""Bytes of the block at `flea3.BASE`."""
MAX_ACK: Final = 1024


class MemoryFault(Exception):
    """An address that the device does not have."""


class Memory:
    """Blocks of memory at addresses, little-endian.

    Parameters
    ----------
    serial : str
        Serial number of the camera.
    line_rate_hz : float
        Rows per second.
    """

    def __init__(self, serial: str, line_rate_hz: float) -> None:
        xml = describe()
        self._blocks = {0: bytearray(0x400), SBRM: bytearray(0x80), SIRM: bytearray(0x40), MANIFEST: bytearray(0x48)}
        self._blocks |= {XML: bytearray(xml), flea3.BASE: bytearray(REGISTERS)}
        for address, text in ((0x04, "napari-elsplus"), (0x44, "virtual FL3-U3-13S2M"), (control.SERIAL, serial)):
            self.write(address, text.encode().ljust(64, b"\0"))
        self._put64({control.MANIFEST: MANIFEST, control.SBRM: SBRM, SBRM + control.SIRM: SIRM})
        self._put64({MANIFEST: 1, MANIFEST + 0x10: XML, MANIFEST + 0x18: len(xml)})
        self._put32({0x00: 0x0001_0001, 0x1CC: 200, MANIFEST + 0x08: 0x0101_0000})
        self._put32({SBRM: 0x0001_0000, SBRM + control.MAX_COMMAND: MAX_ACK, SBRM + control.MAX_ACK: MAX_ACK})
        self._put32({SBRM + 0x1C: 1, SBRM + 0x28: 0x40, SBRM + 0x40: 8})
        self._put32({SIRM + stream.INFO: 2 << 24, SIRM + stream.LEADER_BYTES: 52, SIRM + stream.TRAILER_BYTES: 32})
        rows, cols = SENSOR_SHAPE
        base = flea3.BASE
        self._put32({base + flea3.MAX_SIZE: cols << 16 | rows, base + flea3.SIZE: cols << 16 | rows})
        self._put32({base + flea3.UNIT_SIZE: 16 << 16 | 4, base + flea3.LINE_FREQUENCY: round(line_rate_hz)})
        self._put32({base + flea3.STROBE_OFFSET: (STROBE - flea3.IIDC) // 4})
        for mode in (flea3.FRAME_RATE_MODE, flea3.EXPOSURE_MODE, flea3.GAIN_MODE):
            self.put(base + mode, flea3.AUTO)
        self._put_floats({base + flea3.GAIN_MIN: 0.0, base + flea3.GAIN_MAX: 24.0, base + flea3.RATE_MIN: 1.0})
        self._put_floats({base + flea3.EXPOSURE_MIN: 1e-6, base + flea3.EXPOSURE: 0.005, base + flea3.RATE: 30.0})

    def read(self, address: int, count: int) -> bytes:
        """Read `count` bytes from an address on.

        Raises
        ------
        MemoryFault
            If they are not all in one block.
        """
        block, at = self._find(address, count)
        return bytes(block[at : at + count])

    def write(self, address: int, data: bytes) -> None:
        """Write data from an address on.

        Raises
        ------
        MemoryFault
            As `read`.
        """
        block, at = self._find(address, len(data))
        block[at : at + len(data)] = data

    def get(self, address: int) -> int:
        """Return the 32-bit number at an address."""
        return int.from_bytes(self.read(address, 4), "little")

    def get_float(self, address: int) -> float:
        """Return the 32-bit float at an address."""
        return float(struct.unpack("<f", self.read(address, 4))[0])

    def put(self, address: int, value: int) -> None:
        """Write a value as 32-bit number to an address."""
        self.write(address, struct.pack("<I", value))

    def put_float(self, address: int, value: float) -> None:
        """Write a value as 32-bit float to an address."""
        self.write(address, struct.pack("<f", value))

    def put64(self, address: int, value: int) -> None:
        """Write a value as 64-bit number to an address."""
        self.write(address, struct.pack("<Q", value))

    def _find(self, address: int, count: int) -> tuple[bytearray, int]:
        for start, block in self._around(address):
            if address + count <= start + len(block):
                return block, address - start
        raise MemoryFault(f"{address:#x}")

    def _around(self, address: int) -> Iterator[tuple[int, bytearray]]:
        return ((start, block) for start, block in self._blocks.items() if start <= address < start + len(block))

    def _put32(self, numbers: dict[int, int]) -> None:
        for address, value in numbers.items():
            self.put(address, value)

    def _put64(self, numbers: dict[int, int]) -> None:
        for address, value in numbers.items():
            self.put64(address, value)

    def _put_floats(self, numbers: dict[int, float]) -> None:
        for address, value in numbers.items():
            self.put_float(address, value)
