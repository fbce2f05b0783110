"""The stream: a thread that reads frames into buffers made beforehand, and a queue of fixed length."""

from __future__ import annotations

import errno
import threading
import time
from array import array
from collections import Counter, deque
from math import inf
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Final

import numpy as np
from usb.core import USBError, USBTimeoutError

from napari_elsplus.errors import DeviceError
from napari_elsplus.hardware.priority import Rank, join_frame_core
from napari_elsplus.hardware.protocols import FrameInfo
from napari_elsplus.hardware.u3v.discovery import translate_usb_errors
from napari_elsplus.hardware.u3v.packets import (
    IMAGE,
    MONO8,
    TRAILER_MAGIC,
    Leader,
    PacketError,
    Trailer,
    parse_leader,
    parse_trailer,
)
from napari_elsplus.hardware.u3v.transfers import PACKET

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from usb.core import Device

POLL_MS: Final = 50
"""Milliseconds until a reading thread notices that the stream is being stopped; chosen."""
DEPTH: Final = 32
"""Frames that wait for their reader: an eighth of a second at 240 Hz, for a computer that is busy elsewhere."""
MAX_HALTS: Final = 8
"""Halts of the endpoint without a frame between them after which the stream ends; chosen: one is made up for."""


class _Slot:
    """Transfers of one frame, its number and times, and the bytes after each of its lines."""

    def __init__(self, sizes: list[int]) -> None:
        self.transfers = [array("B", bytes(size)) for size in sizes]
        self._bytes = [np.frombuffer(transfer, np.uint8) for transfer in self.transfers]
        self.info, self.padding_x = FrameInfo(0, 0.0, 0.0), 0

    def copy_into(self, buffer: NDArray[np.uint8]) -> None:
        if self.padding_x:
            rows, cols = buffer.shape
            lines = np.concatenate(self._bytes)[: rows * (cols + self.padding_x)]
            buffer[:] = lines.reshape(rows, cols + self.padding_x)[:, :cols]
            return
        flat, done = buffer.reshape(-1), 0
        for part in self._bytes:
            count = min(len(part), len(flat) - done)
            flat[done : done + count] = part[:count]
            done += count


class U3vStream:
    """Frames of a streaming device.

    Parameters
    ----------
    device : usb.core.Device
        Open device.
    endpoint : int
        Its stream endpoint.
    sizes : list of int
        Bytes of a frame's transfers, from `negotiate_transfers`.
    frame_shape : tuple of int
        Rows and columns.
    timeout_s : float
        Time in which the rest of a frame must follow its leader.
    tick_s : float
        Seconds per unit of the timestamps.
    period_s : float
        Seconds from frame to frame, by which frames without timestamps are timed.
    skip : int
        Number of invalid frames at the start.
    wait_for_reader : bool
        Hold the device up while the queue is full instead of dropping frames; only a simulated device can wait.
    """

    def __init__(
        self,
        device: Device,
        endpoint: int,
        sizes: list[int],
        frame_shape: tuple[int, int],
        *,
        timeout_s: float = 0.5,
        tick_s: float = 1e-9,
        period_s: float = 0.0,
        skip: int = 0,
        wait_for_reader: bool = False,
    ) -> None:
        self._device, self._endpoint, self._frame_shape = device, endpoint, frame_shape
        self._patience_ms = max(POLL_MS, round(timeout_s * 1000))
        self._tick_s, self._period_s = tick_s, period_s
        self._skip, self._wait = skip, wait_for_reader
        self._free = deque(_Slot(sizes) for _ in range(DEPTH))
        self._freed = threading.Event()
        self._ready: SimpleQueue[_Slot | None] = SimpleQueue()
        self._spill = _Slot(sizes)
        self._small = array("B", bytes(PACKET))
        self._halts, self._timed_out = 0, False
        self._fault: Exception | None = None
        self._stopping = threading.Event()
        self._last_block: int | None = None
        """Number of the last frame whose leader and trailer agree."""
        self._unsettled: list[str] = []
        """Causes that were counted after it."""
        self.dropped: Counter[str] = Counter()
        self.received = 0
        self.whole, self.shortest_payload_s = 0, inf
        """Frames with all bytes, and the shortest time in which those of one came after its leader."""
        self.has_timestamps = True
        """The last frame's leader had a timestamp."""
        self._thread = threading.Thread(target=self._run, name="camera stream", daemon=True)
        self._thread.start()

    def read_into(self, buffer: NDArray[np.uint8], timeout_s: float) -> FrameInfo:
        """Fill a buffer with the oldest frame; see :meth:`napari_elsplus.hardware.protocols.Camera.read_into`."""
        try:
            slot = self._ready.get(timeout=timeout_s)
        except Empty:
            raise TimeoutError(f"no frame within {timeout_s:g} s") from None
        if slot is None:
            self._ready.put(None)  # for whoever reads next, too
            assert self._fault is not None
            raise self._fault
        slot.copy_into(buffer)
        info = slot.info
        self._free.append(slot)
        if self._wait:
            self._freed.set()
        return info

    def stop(self) -> None:
        """End the thread, within `POLL_MS`."""
        self._stopping.set()
        self._freed.set()
        self._thread.join()

    def _run(self) -> None:
        join_frame_core(Rank.CAMERA)
        try:
            with translate_usb_errors("the camera"):
                while not self._stopping.is_set():
                    self._read_frame()
        except Exception as error:  # noqa: BLE001 - raised by the next read
            self._fault = error
            self._ready.put(None)

    def _read_frame(self) -> None:
        packet = self._read_small()
        if packet is None:
            return
        try:
            leader = parse_leader(packet)
        except PacketError:
            self._count("bad leader")
            self._resynchronise()
            return
        if leader.payload_type != IMAGE:
            raise DeviceError("the camera sends chunk data behind its images", "switch ChunkModeActive off")
        self.received += 1
        slot = self._take_slot()
        slot.padding_x, halts = leader.padding_x, self._halts
        begin_s = time.perf_counter()
        is_whole = self._read_payload(slot)
        if is_whole:
            self.whole += 1
            self.shortest_payload_s = min(self.shortest_payload_s, time.perf_counter() - begin_s)
        trailer = self._read_trailer() if is_whole else None
        arrived_s = time.perf_counter()
        cause = self._why_bad(leader, trailer)
        if confirmed := trailer is not None and trailer.block_id == leader.block_id:
            self._settle(leader.block_id)
        if cause is None and self._skip:
            self._skip, cause = self._skip - 1, "invalid after a change"
        if slot is self._spill:
            cause = cause or "slow consumer"
        self.has_timestamps = leader.timestamp != 0
        time_s = leader.timestamp * self._tick_s if self.has_timestamps else leader.block_id * self._period_s
        slot.info = FrameInfo(leader.block_id, arrived_s, time_s)
        if cause is not None:
            self._count(cause, unsettled=not confirmed)
        if cause is None:
            self._ready.put(slot)
        elif slot is not self._spill:
            self._free.append(slot)
        if trailer is not None:
            self._halts = 0
        elif self._halts == halts:  # after a halt the next packet is a leader
            self._resynchronise()

    def _read_payload(self, slot: _Slot) -> bool:
        """Read a frame's transfers; return True if they hold all bytes of the image."""
        came = 0
        for transfer in slot.transfers:
            count = self._read_transfer(transfer, self._patience_ms)
            if self._timed_out and 0 < count < len(transfer):
                count = self._read_rest(transfer, count)
            came += count
            if count < len(transfer):
                break
        return came >= self._image_bytes(slot.padding_x)

    def _read_rest(self, transfer: array[int], came: int) -> int:
        """Read on where a slow bus had carried `came` bytes of a transfer in time; return the bytes of all."""
        while self._timed_out and came < len(transfer) and came % PACKET == 0:
            rest = array("B", bytes(len(transfer) - came))
            count = self._read_transfer(rest, self._patience_ms)
            memoryview(transfer)[came : came + count] = memoryview(rest)[:count]
            came += count
            if not count:
                break
        return came

    def _image_bytes(self, padding_x: int) -> int:
        return self._frame_shape[0] * (self._frame_shape[1] + padding_x)

    def _why_bad(self, leader: Leader, trailer: Trailer | None) -> str | None:
        rows, cols = self._frame_shape
        if trailer is None or trailer.block_id != leader.block_id or trailer.status:
            return "bad trailer" if trailer is not None else "short frame"
        if trailer.valid_bytes < self._image_bytes(leader.padding_x):
            return "short frame"
        if (leader.rows, leader.cols, leader.pixel_format) != (rows, cols, MONO8):
            return "other format"
        return None

    def _count(self, cause: str, *, unsettled: bool = True) -> None:
        """Count a frame that was lost by a cause; `unsettled`: its number was not confirmed, it may be no frame."""
        self.dropped[cause] += 1
        if unsettled:
            self._unsettled.append(cause)

    def _settle(self, number: int) -> None:
        """Count as many frames as are missing before the one of that number, which leader and trailer confirm."""
        last, self._last_block = self._last_block, number
        if last is not None and (self._unsettled or number != last + 1):
            missing = max(number - last - 1, 0)
            self.dropped -= Counter(self._unsettled[missing:])
            self.dropped += Counter(gap=max(missing - len(self._unsettled), 0))
        self._unsettled.clear()

    def _take_slot(self) -> _Slot:
        while self._wait and not self._free and not self._stopping.is_set():
            self._freed.wait()
            self._freed.clear()
        return self._free.pop() if self._free else self._spill  # the last one read is still in the caches

    def _read_small(self) -> bytes | None:
        """Return a leader or trailer; None if none came within `POLL_MS`, or the packet was empty."""
        count = self._read_transfer(self._small)
        return self._small[:count].tobytes() if count else None

    def _read_trailer(self) -> Trailer | None:
        for _ in range(2):  # a device may end the payload with an empty packet
            packet = self._read_small()
            if packet is not None:
                try:
                    return parse_trailer(packet)
                except PacketError:
                    return None
        return None

    def _read_transfer(self, buffer: array[int], timeout_ms: int = POLL_MS) -> int:
        """Read one transfer and return its bytes; 0 if none came in time, or the stream is being stopped.

        `_timed_out` is set where the time was up before the transfer was whole.
        """
        for _ in range(-(-timeout_ms // POLL_MS)):
            begin_s = time.perf_counter()
            try:
                count = int(self._device.read(self._endpoint, buffer, POLL_MS))
            except USBTimeoutError:
                if self._stopping.is_set():
                    break
            except USBError as error:
                if error.errno != errno.EPIPE or self._halts >= MAX_HALTS:
                    raise
                self._halts += 1
                self._count("halted endpoint")
                self._device.clear_halt(self._endpoint)
                break
            else:
                self._timed_out = time.perf_counter() - begin_s >= POLL_MS / 1000
                return count
        self._timed_out = True
        return 0

    def _resynchronise(self) -> None:
        """Read until a packet ends a frame, so that the next one can be a leader."""
        for _ in range(16):
            for transfer in self._spill.transfers:
                if self._stopping.is_set():
                    return
                if self._read_transfer(transfer) == 0 or transfer[:4].tobytes() == TRAILER_MAGIC:
                    return
