"""Bootstrap registers of the virtual camera: ABRM of GenCP, SBRM and SIRM of USB3 Vision."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from napari_elsplus.hardware.virtual.camera.memory import Register, constant, number, text
from napari_elsplus.hardware.virtual.camera.standard import (
    CHUNK_TRAILER_BYTES,
    INVALID_PARAMETER,
    LEADER_BYTES,
    NOT_IMPLEMENTED,
    PAYLOAD_NOT_ALIGNED,
    STREAM_REGISTERS_INCONSISTENT,
    WRITE_PROTECT,
    Refusal,
)

if TYPE_CHECKING:
    from collections.abc import Callable

SBRM, SIRM, MANIFEST = 0x1_0000, 0x2_0000, 0x3_0000
"""Addresses of the register blocks; chosen, a host has to read them."""
MAX_TRANSFER: Final = 1024
"""Bytes of a command or an acknowledgement at most."""
SUPER_SPEED: Final = 1 << 3
"""Bit of the current speed (USB3 Vision 1.0.1, SBRM)."""


@dataclass
class Identity:
    """Texts and numbers of the technology agnostic bootstrap registers."""

    model: str
    serial: str
    max_response_ms: int = 200
    timestamps: bool = True


class Timestamp:
    """Timestamp and its latch (GenCP 1.1, ABRM 1F0h to 1FCh).

    Parameters
    ----------
    identity : Identity
        States if there are timestamps.
    ticks : callable
        Returns the device's time.
    """

    def __init__(self, identity: Identity, ticks: Callable[[], int]) -> None:
        self._identity, self._ticks, self._latched = identity, ticks, 0

    def read(self) -> int:
        """Return the time of the last latch."""
        self._refuse_without()
        return self._latched

    def latch(self, value: int) -> None:
        """Latch the time if bit 0 of the value is set."""
        self._refuse_without()
        if value & 1:
            self._latched = self._ticks()

    def _refuse_without(self) -> None:
        if not self._identity.timestamps:
            raise Refusal(NOT_IMPLEMENTED)


def abrm(identity: Identity, timestamp: Timestamp) -> dict[int, Register]:
    """Return the technology agnostic bootstrap registers (GenCP 1.1, ABRM).

    Parameters
    ----------
    identity : Identity
        Texts and response time.
    timestamp : Timestamp
        Its registers.
    """
    return {
        0x0000: constant((0x0001_0001).to_bytes(4, "little")),
        0x0004: text("napari-elsplus"),
        0x0044: text(identity.model),
        0x0084: text("virtual"),
        0x00C4: text("1.0"),
        0x0104: text("no such company"),
        0x0144: Register(64, lambda: identity.serial.encode().ljust(64, b"\0")),
        0x01C4: number(lambda: 0xF00 | (8 if identity.timestamps else 0), size=8),
        0x01CC: number(lambda: identity.max_response_ms),
        0x01D0: number(lambda: MANIFEST, size=8),
        0x01D8: number(lambda: SBRM, size=8),
        0x01E0: number(lambda: 0, size=8),
        0x01F0: number(timestamp.read, size=8),
        0x01F8: Register(4, None, lambda data: timestamp.latch(int.from_bytes(data, "little"))),
        0x01FC: number(lambda: 1, size=8),
        0x0208: constant(bytes(4)),
        0x020C: constant(bytes(4)),
        MANIFEST: number(lambda: 0, size=8),  # the camera has no description of itself
    }


def sbrm() -> dict[int, Register]:
    """Return the technology specific bootstrap registers (USB3 Vision 1.0.1, SBRM)."""
    return {
        SBRM + 0x00: number(lambda: 0x0001_0000),
        SBRM + 0x04: number(lambda: 1, size=8),  # a stream interface, no event interface
        SBRM + 0x0C: number(lambda: 0, size=8),
        SBRM + 0x14: number(lambda: MAX_TRANSFER),
        SBRM + 0x18: number(lambda: MAX_TRANSFER),
        SBRM + 0x1C: number(lambda: 1),
        SBRM + 0x20: number(lambda: SIRM, size=8),
        SBRM + 0x28: number(lambda: 0x30),
        SBRM + 0x2C: constant(bytes(8)),
        SBRM + 0x34: constant(bytes(4)),
        SBRM + 0x38: constant(bytes(8)),
        SBRM + 0x40: number(lambda: SUPER_SPEED),
    }


class StreamInterface:
    """Stream interface registers (USB3 Vision 1.0.1, SIRM), which a host may change only while the stream is disabled.

    Parameters
    ----------
    payload_bytes : callable
        Returns the bytes of a frame as the camera is set.
    on_enable : callable
        Called with True when the stream is enabled, False when it is disabled.

    Attributes
    ----------
    alignment : int
        Bytes in whose multiples transfers are sized, a power of two.
    max_transfer : int
        Largest payload transfer size; larger ones are clamped, which the host finds by reading them back.
    """

    alignment = 1024
    max_transfer = 1 << 32

    def __init__(self, payload_bytes: Callable[[], int], on_enable: Callable[[bool], None]) -> None:
        self.enabled = False
        self._payload_bytes, self._on_enable = payload_bytes, on_enable
        self._held = dict.fromkeys((0x18, 0x1C, 0x20, 0x24, 0x28, 0x2C), 0)

    def registers(self) -> dict[int, Register]:
        """Return the registers by their addresses."""
        fixed = {
            0x00: number(lambda: self.alignment.bit_length() - 1 << 24),
            0x04: number(lambda: int(self.enabled), self._control),
            0x08: number(self._payload_bytes, size=8),
            0x10: number(lambda: LEADER_BYTES),
            0x14: number(lambda: CHUNK_TRAILER_BYTES),
        }
        held = {offset: number(lambda at=offset: self._held[at], self._put(offset)) for offset in self._held}  # type: ignore[misc]
        return {SIRM + offset: register for offset, register in (fixed | held).items()}

    @property
    def transfer_sizes(self) -> list[int]:
        """Bytes that the host has reserved for each payload transfer of a frame."""
        held = self._held
        return [held[0x1C]] * held[0x20] + [size for size in (held[0x24], held[0x28]) if size]

    def _put(self, offset: int) -> Callable[[int], None]:
        def put(value: int) -> None:
            if self.enabled:
                raise Refusal(WRITE_PROTECT)
            self._held[offset] = min(value, self.max_transfer) if offset == 0x1C else value

        return put

    def _control(self, value: int) -> None:
        if value & ~1:
            raise Refusal(INVALID_PARAMETER)
        if value and not self.enabled:
            self._refuse_inconsistent()
        changed, self.enabled = self.enabled != bool(value), bool(value)
        if changed:
            self._on_enable(self.enabled)

    def _refuse_inconsistent(self) -> None:
        held = self._held
        if any(held[at] % self.alignment for at in (0x1C, 0x24, 0x28)):
            raise Refusal(PAYLOAD_NOT_ALIGNED)
        fits = sum(self.transfer_sizes) >= self._payload_bytes()
        if not (fits and held[0x20] and held[0x18] >= LEADER_BYTES and held[0x2C] >= CHUNK_TRAILER_BYTES):
            raise Refusal(STREAM_REGISTERS_INCONSISTENT)
