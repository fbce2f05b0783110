"""The virtual camera's memory: registers at addresses, each with its access and what reading and writing do."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from struct import pack, unpack
from typing import TYPE_CHECKING

from napari_elsplus.hardware.virtual.camera.standard import ACCESS_DENIED, INVALID_ADDRESS, WRITE_PROTECT, Refusal

if TYPE_CHECKING:
    from collections.abc import Callable


@dataclass(frozen=True, slots=True)
class Register:
    """A register: its size in bytes, and what reading and writing it do; None where that is not allowed."""

    size: int
    read: Callable[[], bytes] | None = None
    write: Callable[[bytes], None] | None = None


def constant(value: bytes) -> Register:
    """Return a register that holds a value."""
    return Register(len(value), lambda: value)


def text(value: str) -> Register:
    """Return a bootstrap register of 64 bytes that holds a text `value`."""
    return constant(value.encode("ascii").ljust(64, b"\0"))


def number(get: Callable[[], int], put: Callable[[int], None] | None = None, size: int = 4) -> Register:
    """Return a register of an unsigned number.

    Parameters
    ----------
    get : callable
        Returns the number.
    put : callable, optional
        Called with the number that is written; may raise `Refusal`.
    size : int
        Bytes.
    """
    write = None if put is None else lambda data: put(int.from_bytes(data, "little"))
    return Register(size, lambda: get().to_bytes(size, "little"), write)


def real(get: Callable[[], float], put: Callable[[float], None] | None = None) -> Register:
    """Return a register of a 32-bit float.

    Parameters
    ----------
    get : callable
        Returns the number.
    put : callable, optional
        Called with the number that is written; may raise `Refusal`.
    """
    write = None if put is None else lambda data: put(unpack("<f", data)[0])
    return Register(4, lambda: pack("<f", get()), write)


class Memory:
    """Registers at addresses; what lies between them does not exist."""

    def __init__(self) -> None:
        self._registers: dict[int, Register] = {}
        self._starts: list[int] = []

    def add(self, registers: dict[int, Register]) -> None:
        """Add registers, or replace those at the same addresses."""
        self._registers.update(registers)
        self._starts = sorted(self._registers)

    def read(self, address: int, count: int) -> bytes:
        """Read `count` bytes from an address on.

        Raises
        ------
        Refusal
            If one of them does not exist, or may not be read.
        """
        parts = []
        while count > 0:
            start, register = self._at(address)
            if register.read is None:
                raise Refusal(ACCESS_DENIED)
            part = register.read()[address - start :][:count]
            parts.append(part)
            address, count = address + len(part), count - len(part)
        return b"".join(parts)

    def write(self, address: int, data: bytes) -> None:
        """Write data from an address on, whole registers.

        Raises
        ------
        Refusal
            If one of them does not exist, may not be written, or does not accept its value.
        """
        while data:
            start, register = self._at(address)
            if start != address or len(data) < register.size:
                raise Refusal(INVALID_ADDRESS)
            if register.write is None:
                raise Refusal(WRITE_PROTECT)
            register.write(data[: register.size])
            address, data = address + register.size, data[register.size :]

    def _at(self, address: int) -> tuple[int, Register]:
        index = bisect_right(self._starts, address) - 1
        if index >= 0:
            start = self._starts[index]
            if address < start + self._registers[start].size:
                return start, self._registers[start]
        raise Refusal(INVALID_ADDRESS)
