"""The virtual camera on a Linux kernel's bus: a server of USB/IP (Linux, Documentation/usb/usbip_protocol.rst).

The first line of a connection is JSON: ``{"attach": speed}`` plugs a new camera in, and what follows are the kernel's
requests; ``{"faults": {name: value}}`` changes the camera that was plugged in last.
"""

from __future__ import annotations

import errno
import json
import queue
import socket
import struct
import threading
from array import array
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from usb.core import USBError, USBTimeoutError

from camera_description import add_description
from faulty_camera import FaultyCamera
from napari_elsplus.hardware.virtual.camera import descriptors
from napari_elsplus.hardware.virtual.camera.descriptors import CONTROL_IN, STREAM_IN
from napari_elsplus.hardware.virtual.camera.device import Shot, VirtualCamera
from napari_elsplus.hardware.virtual.timeline import BenchClock, StrobeTrain
from rig.image import image

SUPER_SPEED = 5
"""The kernel's code of USB 3.0 (include/uapi/linux/usb/ch9.h)."""
REQUEST = struct.Struct(">6Ii12x8s")
"""Command, sequence number, device, direction, endpoint, flags or number of the request to unlink, length, setup."""
REPLY = struct.Struct(">5Iii20x")
CAPABILITIES = (
    bytes([5, 0x0F, 22, 0, 2])
    + bytes([7, 0x10, 2, 2, 0, 0, 0])
    + (bytes([10, 0x10, 3, 0, 0x0E, 0, 1, 0x0A, 0xFF, 0x07]))
)
"""Binary device object store: power management of links, and the speeds (USB 3.0, 9.6.2)."""
SUBMIT, UNLINK, SUBMITTED, UNLINKED = 1, 2, 3, 4
RESPONSE_MS = 2000
"""Response time that the camera states, for a machine whose processor is emulated; aravis waits as long for frames."""
POLL_S = {CONTROL_IN: 0.002, STREAM_IN: 0.02}
"""Seconds after which a read tests if its request was taken back."""


class Scene:
    """What the camera sees, on the computer's clock; the strobe is not wired."""

    clock = BenchClock()

    def strobe(self, train: StrobeTrain | None) -> None:
        """Ignore the strobe."""

    def prepare(self, shot: Shot) -> None:
        """Do nothing: images need no preparation."""

    def expose(self, shot: Shot, out: NDArray[np.uint8]) -> None:
        """Fill a frame."""
        out[:] = image(shot.frame, out.shape)


@dataclass
class Reading:
    """A request that waits for data, and the number of the request that takes it back, if one does."""

    number: int
    length: int
    unlinked_by: int | None = None


class Attached:
    """A camera that a kernel uses over a connection."""

    def __init__(self, camera: VirtualCamera, connection: socket.socket, speed: int) -> None:
        self._camera, self._connection, self._is_super = camera, connection, speed == SUPER_SPEED
        self._lock, self._readings = threading.RLock(), dict[int, Reading]()
        self._queues = {endpoint: queue.SimpleQueue[Reading | None]() for endpoint in POLL_S}

    def serve(self) -> None:
        """Answer requests until the connection ends."""
        workers = [threading.Thread(target=self._serve_reads, args=(endpoint,), daemon=True) for endpoint in POLL_S]
        for worker in workers:
            worker.start()
        while header := receive(self._connection, REQUEST.size):
            self._dispatch(*REQUEST.unpack(header))
        for reading in list(self._readings.values()):
            reading.unlinked_by = 0
        for waiting in self._queues.values():
            waiting.put(None)

    def _dispatch(
        self, command: int, number: int, _: int, inwards: int, endpoint: int, word: int, length: int, setup: bytes
    ) -> None:
        if command == UNLINK:
            with self._lock:
                reading = self._readings.get(word)
                if reading is not None:
                    reading.unlinked_by = number  # its worker answers
                    return
            self._reply(UNLINKED, number, 0)
        elif endpoint and inwards:
            with self._lock:
                reading = self._readings[number] = Reading(number, length)
            self._queues[0x80 | endpoint].put(reading)
        else:
            data = b"" if inwards else receive(self._connection, length)
            try:
                answer = self._control(setup)[:length] if endpoint == 0 else self._write(data)
            except USBError as error:
                self._reply(SUBMITTED, number, -(error.errno or errno.EPROTO))
            else:
                self._reply(SUBMITTED, number, 0, answer, len(answer) if inwards else length)

    def _write(self, data: bytes) -> bytes:
        self._camera.control_endpoint.write(data)
        return b""

    def _control(self, setup: bytes) -> bytes:
        """Execute a request to endpoint 0 (USB 3.0, table 9-4); what only the bus concerns is accepted."""
        kind, request, value, index = struct.unpack_from("<BBHH", setup)
        if request == 6:
            return self._descriptor(value >> 8, value & 0xFF)
        if request == 1 and kind == 2:  # clear the halt of an endpoint
            camera = self._camera
            (camera.stream_endpoint if index == STREAM_IN else camera.control_endpoint).clear_halt()
        return {0: bytes(2), 8: bytes([1])}.get(request, b"")

    def _descriptor(self, kind: int, index: int) -> bytes:
        if kind == 1:
            return descriptors.device(False, self._is_super)
        if kind == 2:
            return descriptors.configuration(False, self._is_super)
        if kind == 3 and index <= 3:
            return descriptors.string(index, self._camera.serial)
        if kind == 15 and self._is_super:
            return CAPABILITIES
        raise USBError("no such descriptor", None, errno.EPIPE)

    def _serve_reads(self, endpoint: int) -> None:
        """Fill the requests of an endpoint in turn, but those that are taken back."""
        read: Callable[[array[int], float], int] = (
            self._camera.stream_endpoint.read if endpoint == STREAM_IN else self._read_acknowledgement
        )
        while (reading := self._queues[endpoint].get()) is not None:
            buffer, count, status = array("B", bytes(reading.length)), 0, -errno.ECONNRESET
            while reading.unlinked_by is None and status == -errno.ECONNRESET:
                try:
                    count, status = read(buffer, POLL_S[endpoint]), 0
                except USBTimeoutError:
                    continue
                except USBError as error:
                    status = -(error.errno or errno.EPROTO)
            with self._lock:  # nobody may be told that a request is done before its data are sent
                del self._readings[reading.number]
                if status != -errno.ECONNRESET:
                    self._reply(SUBMITTED, reading.number, status, memoryview(buffer)[:count], count)
                    status = 0
                if reading.unlinked_by is not None:
                    self._reply(UNLINKED, reading.unlinked_by, status)

    def _read_acknowledgement(self, buffer: array[int], timeout_s: float) -> int:
        answer = self._camera.control_endpoint.read(timeout_s)
        if len(answer) > len(buffer):
            raise USBError("Overflow", None, errno.EOVERFLOW)
        buffer[: len(answer)] = array("B", answer)
        return len(answer)

    def _reply(self, command: int, number: int, status: int, data: bytes | memoryview = b"", length: int = 0) -> None:
        with self._lock:
            try:
                self._connection.sendall(REPLY.pack(command, number, 0, 0, 0, status, length) + bytes(data))
            except OSError:
                return  # detached meanwhile


class CameraServer:
    """Cameras for the kernels that connect to a port of this computer; a daemon thread each."""

    def __init__(self) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = int(self._listener.getsockname()[1])
        self._camera = _camera()
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        while True:
            connection, _ = self._listener.accept()
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            threading.Thread(target=self._serve, args=(connection,), daemon=True).start()

    def _serve(self, connection: socket.socket) -> None:
        with connection:
            line = b""
            while not line.endswith(b"\n"):
                line += receive(connection, 1)
            wanted = json.loads(line)
            if "attach" in wanted:
                self._camera = _camera()
                Attached(self._camera, connection, wanted["attach"]).serve()
                return
            for name, value in wanted["faults"].items():
                setattr(self._camera.faults, name, value)
            connection.sendall(b"\n")


def _camera() -> VirtualCamera:
    camera = FaultyCamera(Scene(), serial="4711")
    camera.identity.max_response_ms = RESPONSE_MS
    add_description(camera)
    return camera


def receive(connection: socket.socket, count: int) -> bytes:
    """Return that many bytes; none where the connection has ended."""
    data = bytearray()
    while len(data) < count:
        try:
            part = connection.recv(count - len(data))
        except OSError:
            part = b""
        if not part:
            return b""
        data += part
    return bytes(data)
