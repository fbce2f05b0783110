"""The virtual camera's endpoints: control commands with their acknowledgements, and the stream as bulk transfers."""

from __future__ import annotations

import errno
import threading
from collections import deque
from dataclasses import dataclass
from struct import pack, unpack_from
from typing import TYPE_CHECKING, Final

import numpy as np
from usb.core import USBError, USBTimeoutError

from napari_elsplus.hardware.virtual.camera import standard
from napari_elsplus.hardware.virtual.camera.bootstrap import MAX_TRANSFER
from napari_elsplus.hardware.virtual.camera.standard import Refusal

if TYPE_CHECKING:
    from array import array
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from napari_elsplus.hardware.virtual.camera.memory import Memory
    from napari_elsplus.hardware.virtual.timeline import BenchClock

PACKET: Final = 1024
"""Bytes of a bulk packet at SuperSpeed (USB 3.0, 8.5.1 and table 8-20)."""
IDLE_S: Final = 0.01
"""Seconds that a read waits where no acknowledgement is due; a real one waits for the whole time-out."""


@dataclass
class CameraFaults:
    """Faults to inject.

    Parameters
    ----------
    short_frames, bad_trailers, drop_frames : int
        Number of frames cut short, ended by a bad trailer, or lost.
    strobe_off : bool
        Cut the strobe's wire.
    """

    short_frames: int = 0
    bad_trailers: int = 0
    drop_frames: int = 0
    strobe_off: bool = False

    def take(self, name: str) -> bool:
        """Count the fault of that `name` down; return True if one was left."""
        left = getattr(self, name)
        if left:
            setattr(self, name, left - 1)
        return bool(left)


class ControlEndpoint:
    """Executes control commands on the camera's memory (GenCP 1.1; USB3 Vision 1.0.1, control protocol).

    Parameters
    ----------
    memory : Memory
        The camera's registers.
    clock : BenchClock
        Clock of the bench.
    """

    def __init__(self, memory: Memory, clock: BenchClock) -> None:
        self._memory, self._clock = memory, clock
        self._answers: deque[bytes] = deque()
        self._halted = False

    def write(self, packet: bytes) -> None:
        """Execute a command `packet` and queue its acknowledgement.

        Raises
        ------
        USBError
            If the endpoint is halted, or halts since the command is too long.
        """
        if len(packet) > MAX_TRANSFER:
            self._halted = True
        self._refuse_halted()
        try:
            flags, command, request, body = standard.parse_command(packet)
        except ValueError:
            return  # what is no command has no answer
        status, data = self._execute(command, body)
        if flags & standard.ACKNOWLEDGE:
            self._answers.append(standard.acknowledgement(status, command + 1, request, data))

    def read(self, timeout_s: float) -> bytes:
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
        self._refuse_halted()
        if not self._answers:
            self._clock.wait_until(self._clock.now_s() + min(timeout_s, IDLE_S))
            raise USBTimeoutError("no answer", None, errno.ETIMEDOUT)
        return self._answers.popleft()

    def clear_halt(self) -> None:
        """End a halt."""
        self._halted = False

    def _execute(self, command: int, body: bytes) -> tuple[int, bytes]:
        """Return status and payload of the acknowledgement of a command."""
        try:
            if command == standard.READ_MEMORY and len(body) == 12:
                address, _, count = unpack_from("<QHH", body)
                if count > MAX_TRANSFER - standard.COMMAND_BYTES:
                    raise Refusal(standard.INVALID_PARAMETER)
                return standard.SUCCESS, self._memory.read(address, count)
            if command == standard.WRITE_MEMORY and len(body) > 8:
                self._memory.write(unpack_from("<Q", body)[0], body[8:])
                return standard.SUCCESS, pack("<HH", 0, len(body) - 8)
        except Refusal as refusal:
            return refusal.status, b""
        return standard.NOT_IMPLEMENTED, b""

    def _refuse_halted(self) -> None:
        if self._halted:
            raise USBError("Pipe error", -9, errno.EPIPE)


@dataclass(frozen=True, slots=True)
class Transfer:
    """A bulk transfer of the device: data, and the bytes that the host has reserved for it.

    Parameters
    ----------
    data : numpy.ndarray
        uint8; fewer than `room` end with a short packet, which is empty where they fill whole packets.
    room : int
        Bytes reserved by the host.
    due_s : float
        When the first byte is there.
    """

    data: NDArray[np.uint8]
    room: int
    due_s: float


class StreamEndpoint:
    """Sends the transfers of frames as bulk packets: a read ends where its buffer is full, or at a short packet.

    Parameters
    ----------
    blocks : callable
        Returns the transfers of the next frame, None while the camera does not stream.
    clock : BenchClock
        Clock of the bench.
    """

    def __init__(self, blocks: Callable[[], Iterator[Transfer] | None], clock: BenchClock) -> None:
        self._blocks, self._clock = blocks, clock
        self._lock = threading.Lock()
        self._halted = False
        self.discard()

    def discard(self) -> None:
        """Discard what has not been sent of the current frame."""
        self._block: Iterator[Transfer] | None = None
        self._transfer: Transfer | None = None
        self._sent = 0
        self._free_s = -np.inf

    def clear_halt(self) -> None:
        """End a halt; the current frame is discarded."""
        with self._lock:
            self._halted = False
            self.discard()

    def read(self, buffer: array[int], timeout_s: float) -> int:
        """Fill a buffer with the next packets, and return their bytes.

        Parameters
        ----------
        buffer : array.array
            Bytes.
        timeout_s : float
            Time to wait; what has come until then is returned, as libusb does.

        Raises
        ------
        USBTimeoutError
            If nothing has come.
        USBError
            If the endpoint is halted, or a packet is longer than the rest of the buffer.
        """
        with self._lock:
            if self._halted:
                raise USBError("Pipe error", -9, errno.EPIPE)
            return self._fill(np.frombuffer(buffer, np.uint8), self._clock.now_s() + timeout_s)

    def _fill(self, out: NDArray[np.uint8], until_s: float) -> int:
        got = 0
        while True:
            transfer = self._next(until_s)
            if transfer is None:
                if got:
                    return got
                raise USBTimeoutError("no packet", None, errno.ETIMEDOUT)
            left, room = len(transfer.data) - self._sent, len(out) - got
            take = min(left, room)
            if take == room < left and take % PACKET:
                raise USBError("Overflow", None, errno.EOVERFLOW)
            out[got : got + take] = transfer.data[self._sent : self._sent + take]
            got, self._sent = got + take, self._sent + take
            if self._sent < len(transfer.data):
                return got  # the buffer is full
            self._transfer = None
            if len(transfer.data) % PACKET or len(transfer.data) < transfer.room or got == len(out):
                return got

    def _next(self, until_s: float) -> Transfer | None:
        """Return the transfer that is being sent, None if none begins in time."""
        if self._transfer is None:
            if self._block is None:
                self._block = self._blocks()
            transfer = next(self._block, None) if self._block is not None else None
            if transfer is None and self._block is not None:
                self._block = None
                return self._next(until_s)
            if transfer is None:
                self._wait(until_s)
                return None
            self._transfer, self._sent = transfer, 0
            self._free_s = max(self._free_s, transfer.due_s, self._clock.now_s())  # nothing comes before it is read
        if self._free_s > until_s and self._clock.real_time:
            self._wait(until_s)
            return None
        self._clock.wait_until(self._free_s)
        return self._transfer

    def _wait(self, until_s: float) -> None:
        if self._clock.real_time:
            self._clock.wait_until(until_s)
