"""The virtual USB3 Vision camera: control commands, acquisition on the bench's clock, and the stream."""

from __future__ import annotations

import errno
import struct
import threading
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Protocol

import numpy as np
from usb.core import USBError, USBTimeoutError

from napari_elsplus.hardware.u3v import flea3, packets, stream
from napari_elsplus.hardware.virtual.camera.memory import SIRM, STROBE, Memory, MemoryFault
from napari_elsplus.hardware.virtual.timeline import StrobeTrain
from napari_elsplus.instrument.optics import LINE_RATE_HZ

if TYPE_CHECKING:
    from array import array

    from numpy.typing import NDArray

    from napari_elsplus.hardware.virtual.timeline import BenchClock

BYTES_KEPT: Final = 32 << 20
"""Bytes that the camera buffers while the computer is late (chosen); older frames are lost."""
IDLE: Final = LINE_RATE_HZ / 240 / 524
"""Shortest frame period over the time in which its rows are read, as in the paper's modes."""


@dataclass(frozen=True, slots=True)
class Shot:
    """Timing, region and gain of one frame: the strobe's edge, and when its rows are read."""

    frame: int
    strobe_s: float
    region: tuple[int, int, int, int]
    """Row, col, rows, cols on the sensor."""
    exposure_s: float
    line_period_s: float
    frame_period_s: float
    gain_db: float

    @property
    def row_zero_s(self) -> float:
        """Readout of the first row, in seconds."""
        return self.strobe_s + self.exposure_s

    @property
    def read_out_s(self) -> float:
        """Readout of the last row, in seconds."""
        return self.row_zero_s + self.region[2] * self.line_period_s


class Bench(Protocol):
    """Clock and scene of the camera, and receiver of its strobe."""

    clock: BenchClock

    def strobe(self, train: StrobeTrain | None) -> None:
        """Receive a train of edges."""

    def prepare(self, shot: Shot) -> None:
        """Prepare for frames like a shot."""

    def expose(self, shot: Shot, out: NDArray[np.uint8]) -> None:
        """Fill the frame `out` of a shot."""


@dataclass
class CameraFaults:
    """Faults to inject.

    Parameters
    ----------
    pending_acks, lose_acks : int
        Number of answers that follow a PENDING_ACK, and of answers that are lost.
    short_frames, bad_trailers, drop_frames : int
        Number of frames cut short, ended by a bad trailer, or lost.
    empty_packets : bool
        End payloads with an empty packet.
    strobe_off : bool
        Cut the strobe's wire.
    """

    pending_acks: int = 0
    lose_acks: int = 0
    short_frames: int = 0
    bad_trailers: int = 0
    drop_frames: int = 0
    empty_packets: bool = False
    strobe_off: bool = False


class VirtualCamera:
    """A Flea3 with USB3 Vision firmware, its sensor on the bench.

    Parameters
    ----------
    bench : Bench
        Clock, strobe and scene.
    serial : str
        Serial number.
    line_rate_hz : float
        Rows per second.
    """

    def __init__(self, bench: Bench, *, serial: str = "1", line_rate_hz: float = LINE_RATE_HZ) -> None:
        self.bench, self.serial = bench, serial
        self.faults = CameraFaults()
        self.memory = Memory(serial, line_rate_hz)
        self._line_period_s = 1 / line_rate_hz
        self._answers: deque[bytes] = deque()
        self._lock = threading.RLock()
        self._train: StrobeTrain | None = None
        self._frame = 0
        self._pixels = np.zeros(0, np.uint8)
        self._sent_empty = False
        self._sent = -1  # bytes of the current frame's payload that were sent; -1: its leader was not
        self._settle()

    # Control endpoint.

    def command(self, packet: bytes) -> None:
        """Execute a control command `packet`, and queue the acknowledgement."""
        if len(packet) < packets.HEADER.size:
            return
        _, _, command, _, request_id = packets.HEADER.unpack_from(packet)
        body = packet[packets.HEADER.size :]
        status, data = 0, b""
        try:
            if command == packets.CommandPacket.READ:
                address, _, count = packets.READ.unpack_from(body)
                data = self.memory.read(address, count)
            elif command == packets.CommandPacket.WRITE:
                (address,) = struct.unpack_from("<Q", body)
                self._write(address, body[8:])
                data = struct.pack("<HH", 0, len(body) - 8)
            else:
                status = 0x8001
        except MemoryFault:
            status = 0x8003
        if self.faults.lose_acks:
            self.faults.lose_acks -= 1
            return
        if self.faults.pending_acks:
            self.faults.pending_acks -= 1
            self._answers.append(_ack(0, packets.CommandPacket.PENDING_ACK, request_id, packets.PENDING.pack(0, 50)))
        self._answers.append(_ack(status, command + 1, request_id, data))

    def answer(self, timeout_s: float) -> bytes:
        """Return the next acknowledgement.

        Parameters
        ----------
        timeout_s : float
            Time to wait for it.

        Raises
        ------
        USBTimeoutError
            If there is none.
        """
        if not self._answers:
            self.bench.clock.wait_until(self.bench.clock.now_s() + min(timeout_s, 0.01))
            raise USBTimeoutError("no answer", None, errno.ETIMEDOUT)
        return self._answers.popleft()

    # Stream endpoint.

    def stream_into(self, buffer: array[int], timeout_s: float) -> int:
        """Put the next packet into the buffer: leader, part of the payload, or trailer.

        Parameters
        ----------
        buffer : array.array
            Bytes; a packet that is longer is an overflow.
        timeout_s : float
            Time to wait for a packet to be due.

        Returns
        -------
        int
            Bytes of the packet.

        Raises
        ------
        USBTimeoutError
            If none is due in time.
        """
        with self._lock:
            train, enabled = self._train, self.memory.get(SIRM + stream.ENABLE)
        clock = self.bench.clock
        if train is None or not enabled:
            if clock.real_time:
                clock.wait_until(clock.now_s() + timeout_s)
            raise USBTimeoutError("not streaming", None, errno.ETIMEDOUT)
        shot = self._shot(self._frame, train)
        if self._sent < 0:
            self._skip_lost_frames(train)
            shot = self._shot(self._frame, train)
            self._await(shot.row_zero_s, timeout_s)
            self._sent = 0
            return _put(buffer, _leader(shot))
        size = shot.region[2] * shot.region[3]
        if self._sent < size:
            return self._send_payload(shot, buffer, timeout_s)
        if self.faults.empty_packets and not self._sent_empty:
            self._sent_empty = True
            return 0
        self._frame, self._sent, self._sent_empty = self._frame + 1, -1, False
        return _put(buffer, self._trailer(shot))

    def close(self) -> None:
        """End the acquisition, as a camera does that loses its host."""
        self._acquire(False)

    def _send_payload(self, shot: Shot, buffer: array[int], timeout_s: float) -> int:
        rows, cols = shot.region[2:]
        if self._sent == 0:
            if len(self._pixels) != rows * cols:
                self._pixels = np.zeros(rows * cols, np.uint8)
            self.bench.expose(shot, self._pixels.reshape(rows, cols))
            self._await(shot.read_out_s, timeout_s)
        if self.faults.short_frames:
            self.faults.short_frames -= 1
            self._sent = rows * cols
            return _put(buffer, self._pixels[: len(buffer) // 2])
        part = self._pixels[self._sent : self._sent + len(buffer)]
        self._sent += len(part)
        return _put(buffer, part)

    def _trailer(self, shot: Shot) -> bytes:
        status = 0
        if self.faults.bad_trailers:
            self.faults.bad_trailers -= 1
            status = 0xA001
        rows, cols = shot.region[2:]
        return packets.TRAILER.pack(
            packets.TRAILER_MAGIC, 0, packets.TRAILER.size, shot.frame, status, 0, rows * cols, rows
        )

    def _skip_lost_frames(self, train: StrobeTrain) -> None:
        clock = self.bench.clock
        shot = self._shot(self._frame, train)
        late = int((clock.now_s() - shot.read_out_s) / train.period_s)
        kept = BYTES_KEPT // (shot.region[2] * shot.region[3])
        if clock.real_time and late > kept:
            self._frame += late - kept
        if self.faults.drop_frames:
            self._frame += self.faults.drop_frames
            self.faults.drop_frames = 0

    def _await(self, time_s: float, timeout_s: float) -> None:
        clock = self.bench.clock
        if clock.real_time and time_s > clock.now_s() + timeout_s:
            clock.wait_until(clock.now_s() + timeout_s)
            raise USBTimeoutError("no packet", None, errno.ETIMEDOUT)
        clock.wait_until(time_s)

    # Registers.

    def _write(self, address: int, data: bytes) -> None:
        self.memory.write(address, data)
        if address in {flea3.BASE + r for r in (flea3.SIZE, flea3.RATE, flea3.EXPOSURE)}:
            self._settle()
        if address == flea3.BASE + flea3.ACQUISITION:
            self._acquire(bool(self.memory.get(address) & flea3.ACQUIRE))

    def _settle(self) -> None:
        """Adapt limits and payload to the region and the exposure."""
        base, memory = flea3.BASE, self.memory
        size = memory.get(base + flea3.SIZE)
        rows, cols = size & 0xFFFF, size >> 16
        memory.put64(SIRM + stream.PAYLOAD_BYTES, rows * cols)
        exposure_s = memory.get_float(base + flea3.EXPOSURE)
        fastest = 1 / (rows * IDLE * self._line_period_s)
        memory.put_float(base + flea3.RATE_MAX, fastest)
        memory.put_float(base + flea3.EXPOSURE_MAX, 1 / memory.get_float(base + flea3.RATE))
        memory.put_float(base + flea3.EXPOSURE, exposure_s)

    def _acquire(self, on: bool) -> None:
        clock = self.bench.clock
        with self._lock:
            if on == (self._train is not None):
                return
            if on:
                period_s = 1 / self.memory.get_float(flea3.BASE + flea3.RATE)
                self.bench.prepare(self._shot(0, StrobeTrain(0.0, period_s)))
                self._train = StrobeTrain(clock.now_s() + 2e-3, period_s)
                self._frame, self._sent = 0, -1
                train = self._train if self._strobe_is_on() and not self.faults.strobe_off else None
                self.bench.strobe(train)
                return
            assert self._train is not None
            ended = StrobeTrain(self._train.start_s, self._train.period_s, clock.now_s())
            if self._strobe_is_on() and not self.faults.strobe_off:
                self.bench.strobe(ended)
            self._train = None

    def cut_strobe(self) -> None:
        """Cut the strobe's wire, now."""
        with self._lock:
            self.faults.strobe_off = True
            if self._train is not None:
                self.bench.strobe(StrobeTrain(self._train.start_s, self._train.period_s, self.bench.clock.now_s()))

    def _strobe_is_on(self) -> bool:
        return any(self.memory.get(STROBE + flea3.STROBE_CONTROL + 4 * k) & flea3.STROBE_ON for k in range(4)) or any(
            self.memory.get(flea3.BASE + flea3.GPIO_MODE + 0x10 * k) & flea3.GPIO_STROBE for k in range(4)
        )

    def _shot(self, frame: int, train: StrobeTrain) -> Shot:
        base, memory = flea3.BASE, self.memory
        size, origin = memory.get(base + flea3.SIZE), memory.get(base + flea3.OFFSET)
        return Shot(
            frame,
            train.start_s + frame * train.period_s,
            (origin & 0xFFFF, origin >> 16, size & 0xFFFF, size >> 16),
            memory.get_float(base + flea3.EXPOSURE),
            self._line_period_s,
            train.period_s,
            memory.get_float(base + flea3.GAIN),
        )


def _ack(status: int, command: int, request_id: int, data: bytes) -> bytes:
    return packets.HEADER.pack(packets.COMMAND_MAGIC, status, command, len(data), request_id) + data


def _leader(shot: Shot) -> bytes:
    row, col, rows, cols = shot.region
    time_ns = round(shot.row_zero_s * 1e9)
    return packets.LEADER.pack(
        packets.LEADER_MAGIC, 0, packets.LEADER.size, shot.frame, 0, packets.IMAGE, time_ns, packets.MONO8,
        cols, rows, col, row, 0, 0,
    )  # fmt: skip


def _put(buffer: array[int], data: bytes | NDArray[np.uint8]) -> int:
    """Copy a packet into the buffer; one that is longer than the buffer is libusb's overflow."""
    if len(data) > len(buffer):
        raise USBError("Overflow", None, errno.EOVERFLOW)
    np.frombuffer(buffer, np.uint8)[: len(data)] = np.frombuffer(data, np.uint8)
    return len(data)
