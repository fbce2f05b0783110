"""A virtual camera with the faults and habits of real ones, which the simulated rig does not play."""

from __future__ import annotations

import errno
from collections.abc import Iterator
from dataclasses import dataclass
from struct import pack, pack_into, unpack_from

import numpy as np
from numpy.typing import NDArray
from usb.core import USBTimeoutError

from napari_elsplus.hardware.virtual.camera import standard
from napari_elsplus.hardware.virtual.camera.device import Shot, VirtualCamera
from napari_elsplus.hardware.virtual.camera.endpoints import (
    PACKET,
    CameraFaults,
    ControlEndpoint,
    StreamEndpoint,
    Transfer,
)

BUSY, PENDING = 0x8007, 0x0805
"""GenCP 1.1: the status of a command that is refused, and the acknowledgement that asks for time."""
PENDING_MS = 50
BUS_PART_BYTES = 64 * PACKET
"""What a slow bus has carried of a transfer is there for the host in parts of so many bytes."""
IMAGE_WITH_CHUNKS = 0x4001
"""USB3 Vision 1.0.1, table of payload types."""
CHUNK_BYTES = 24
"""Bytes of the chunks behind an image: a number of 8 bytes, and a trailer of 8 bytes for it and for the image."""
FRAME_INFO_BYTES = 4
"""Bytes of each number that a Flea3 writes over the first pixels (maker's register reference, 12F8h)."""
GAMMA = 0.5
"""Exponent of the lookup table that a camera applies whose gamma was left on: the image is visibly wrong."""


@dataclass
class Faults(CameraFaults):
    """Faults to inject, and what real cameras do that the virtual one does not by itself.

    Parameters
    ----------
    pending_acks, lose_acks, busy_acks : int
        Number of commands that are answered by PENDING_ACK first, whose answer is lost, and that are refused as BUSY.
    ack_delay_s : float
        Time until an acknowledgement is there.
    halt_control, halt_stream : int
        Number of times that an endpoint halts at its next transfer.
    empty_packets : bool
        End payloads with an empty packet that the standard does not require.
    bus_bytes_per_s : float
        Rate of the bus.
    padding_x : int
        Bytes after each line.
    tick_ns : float
        Nanoseconds per unit of the timestamps; the standard requires 1.
    blank_timestamps : bool
        Leaders have timestamps of zero.
    """

    pending_acks: int = 0
    lose_acks: int = 0
    busy_acks: int = 0
    ack_delay_s: float = 0.0
    halt_control: int = 0
    halt_stream: int = 0
    empty_packets: bool = False
    bus_bytes_per_s: float = np.inf
    padding_x: int = 0
    tick_ns: float = 1.0
    blank_timestamps: bool = False


class FaultyControl(ControlEndpoint):
    """Control commands with faults."""

    faults: Faults
    _due_s = 0.0

    def write(self, packet: bytes) -> None:
        self._halted |= self.faults.take("halt_control")
        answers = len(self._answers)
        super().write(packet)
        self._due_s = self._clock.now_s() + self.faults.ack_delay_s
        if len(self._answers) == answers:
            return
        if self.faults.take("lose_acks"):
            self._answers.pop()
        elif self.faults.take("pending_acks"):
            (request,) = unpack_from("<H", packet, 10)
            asked = standard.acknowledgement(standard.SUCCESS, PENDING, request, pack("<HH", 0, PENDING_MS))
            self._answers.insert(answers, asked)

    def read(self, timeout_s: float) -> bytes:
        until_s = self._clock.now_s() + timeout_s
        if self._due_s > until_s:
            self._clock.wait_until(until_s)
            raise USBTimeoutError("no answer yet", None, errno.ETIMEDOUT)
        self._clock.wait_until(self._due_s)
        return super().read(timeout_s)

    def _execute(self, command: int, body: bytes) -> tuple[int, bytes]:
        return (BUSY, b"") if self.faults.take("busy_acks") else super()._execute(command, body)


class FaultyStream(StreamEndpoint):
    """A stream that halts."""

    faults: Faults

    def read(self, buffer, timeout_s: float) -> int:
        self._halted |= self.faults.take("halt_stream")
        return super().read(buffer, timeout_s)


class FaultyCamera(VirtualCamera):
    """A virtual camera with faults, whose images are changed by settings that another program may have left on."""

    faults: Faults

    def __init__(self, bench, **options) -> None:
        super().__init__(bench, **options)
        self.faults, self._bus_free_s = Faults(), -np.inf
        self.control_endpoint = FaultyControl(self.memory, bench.clock)
        self.stream_endpoint = FaultyStream(self._next_block, bench.clock)
        self.control_endpoint.faults = self.stream_endpoint.faults = self.faults

    def _ticks(self, time_s: float) -> int:
        return round(time_s * 1e9 / self.faults.tick_ns)

    def _payload_bytes(self) -> int:
        settings = self.sensor.settings
        lines = settings.rows * (settings.cols + self.faults.padding_x)
        return lines + (CHUNK_BYTES if settings.chunks else 0)

    def _transfers(self, shot: Shot, sizes: list[int]) -> Iterator[Transfer]:
        """The transfers as the bus carries them, a slow one in parts; with empty packets, one before the trailer."""
        rate = self.faults.bus_bytes_per_s
        for transfer in super()._transfers(shot, sizes):
            if self.faults.empty_packets and bytes(transfer.data[:4]) == b"U3VT":
                yield Transfer(transfer.data[:0], PACKET, shot.read_out_s)
            size = max(len(transfer.data), 1)
            part = BUS_PART_BYTES if np.isfinite(rate) else size
            for first in range(0, size, part):
                data = transfer.data[first : first + part]
                begins_s = max(self._bus_free_s, transfer.due_s, self.bench.clock.now_s())
                self._bus_free_s = begins_s + len(data) / rate
                room = len(data) if first + part < size else transfer.room - first
                yield Transfer(data, room, max(self._bus_free_s, transfer.due_s))

    def _leader(self, shot: Shot) -> bytes:
        leader = bytearray(super()._leader(shot))
        if self.sensor.settings.chunks:
            pack_into("<H", leader, 18, IMAGE_WITH_CHUNKS)
        if self.faults.blank_timestamps:
            pack_into("<Q", leader, 20, 0)
        pack_into("<H", leader, 48, self.faults.padding_x)
        return bytes(leader)

    def _trailer(self, shot: Shot, status: int, valid_bytes: int) -> bytes:
        trailer = super()._trailer(shot, status, valid_bytes)
        if not self.sensor.settings.chunks:
            return trailer
        longer = bytearray(trailer + pack("<I", 1))  # the identifier of the chunks' layout
        pack_into("<H", longer, 6, len(longer))
        return bytes(longer)

    def _payload(self, shot: Shot) -> NDArray[np.uint8]:
        settings = self.sensor.settings
        pixels = super()._payload(shot).reshape(shot.region[2:])
        if settings.gamma:
            pixels = np.asarray(255 * (pixels / 255) ** GAMMA, np.uint8)
        if settings.frame_info:
            pixels = pixels.copy()
            pixels.reshape(-1)[: FRAME_INFO_BYTES * settings.frame_info.bit_count()] = 0xAB
        pixels = np.pad(pixels, ((0, 0), (0, self.faults.padding_x)), constant_values=0xCD)
        chunks = np.full(CHUNK_BYTES if settings.chunks else 0, 0xEF, np.uint8)
        return np.concatenate([pixels.reshape(-1), chunks])
