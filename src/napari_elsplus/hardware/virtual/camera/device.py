"""The virtual USB3 Vision camera: its registers, and acquisition on the bench's clock."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from math import ceil
from typing import TYPE_CHECKING, ClassVar, Final, Protocol

import numpy as np

from napari_elsplus.hardware.priority import Rank, join_frame_core
from napari_elsplus.hardware.virtual.camera import bootstrap, standard
from napari_elsplus.hardware.virtual.camera.bootstrap import Identity, StreamInterface, Timestamp
from napari_elsplus.hardware.virtual.camera.endpoints import (
    CameraFaults,
    ControlEndpoint,
    StreamEndpoint,
    Transfer,
)
from napari_elsplus.hardware.virtual.camera.iidc import Flea3Registers
from napari_elsplus.hardware.virtual.camera.memory import Memory
from napari_elsplus.hardware.virtual.camera.sensor import Sensor, SensorModel
from napari_elsplus.hardware.virtual.timeline import StrobeTrain

if TYPE_CHECKING:
    from array import array
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from napari_elsplus.hardware.virtual.camera.memory import Register
    from napari_elsplus.hardware.virtual.timeline import BenchClock

BYTES_KEPT: Final = 32 << 20
"""Bytes that the camera buffers while the computer is late (chosen); older frames are lost."""
LATE_FRAMES: Final = 2
"""Frames by which the simulation is late from which it skips those that nothing waits for; chosen: one is chance."""
WIRED_LINE: Final = 1
"""Line of the camera that is wired to the card."""


@dataclass(frozen=True, slots=True)
class Shot:
    """Timing, region and gain of one frame: the strobe's edge, and when its rows are read.

    ``skipped`` is the number of frames before it that a simulation left out because it was late: nothing lit the
    specimen then.
    """

    frame: int
    strobe_s: float
    region: tuple[int, int, int, int]
    """Row, col, rows, cols on the sensor."""
    exposure_s: float
    line_period_s: float
    frame_period_s: float
    gain_db: float
    skipped: int = 0

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


class Make(Protocol):
    """Registers of a make of camera."""

    name: ClassVar[str]
    model: ClassVar[SensorModel]

    def __init__(self, sensor: Sensor, acquire: Callable[[bool], None]) -> None:
        """Build them on the sensor's settings; `acquire` is called with True to start acquisition, False to end it."""

    def registers(self) -> dict[int, Register]:
        """Return the registers by their addresses."""

    def strobe_delay_s(self, line: int) -> float | None:
        """Seconds from the beginning of the exposure to the edge on a line; None: there is none."""


class VirtualCamera:
    """A USB3 Vision camera, its sensor on the bench.

    Parameters
    ----------
    bench : Bench
        Clock, scene, and where the strobe goes.
    serial : str
        Its serial number.
    make : type
        Its registers: those of a Flea3, or of another make.
    moved_s : callable, optional
        Returns when the galvo was moved last. Frames that were read out before are not kept by a simulation that is
        late: what moved it, a calibration, waits for those that follow.
    """

    def __init__(
        self,
        bench: Bench,
        *,
        serial: str = "1",
        make: type[Make] = Flea3Registers,
        moved_s: Callable[[], float] | None = None,
    ) -> None:
        self.bench, self.faults, self._lock = bench, CameraFaults(), threading.RLock()
        self._moved_s = moved_s
        self._train: StrobeTrain | None = None
        self._wired: StrobeTrain | None = None
        """Edges that the card receives."""
        self.stream = StreamInterface(self._payload_bytes, self._enable)
        self.sensor = Sensor(make.model, lambda: self.stream.enabled or self._train is not None)
        self.make = make(self.sensor, self._acquire)
        self.identity = Identity(self.make.name, serial)
        self.memory = Memory()
        timestamp = Timestamp(self.identity, lambda: self._ticks(bench.clock.now_s()))
        for registers in (
            bootstrap.abrm(self.identity, timestamp), bootstrap.sbrm(), self.stream.registers(), self.make.registers(),
        ):  # fmt: skip
            self.memory.add(registers)
        self.control_endpoint = ControlEndpoint(self.memory, bench.clock)
        self.stream_endpoint = StreamEndpoint(self._next_block, bench.clock)
        self._frame = self._skipped = 0
        self._pixels = np.zeros(0, np.uint8)
        self._simulation = ThreadPoolExecutor(1, initializer=_begin_simulation)

    @property
    def serial(self) -> str:
        """Serial number."""
        return self.identity.serial

    def cut_strobe(self) -> None:
        """Cut the strobe's wire, now."""
        with self._lock:
            self.faults.strobe_off = True
            self._end_strobe()

    # Acquisition.

    def _acquire(self, on: bool) -> None:
        clock = self.bench.clock
        with self._lock:
            if on == (self._train is not None):
                return
            if on:
                period_s = 1 / self.sensor.rate_hz
                self.bench.prepare(self._shot(0, StrobeTrain(0.0, period_s)))
                self._train = StrobeTrain(clock.now_s() + 2e-3, period_s)
                self._frame = self._skipped = 0
                delay_s = self.make.strobe_delay_s(WIRED_LINE)
                if delay_s is not None and not self.faults.strobe_off and not self.sensor.settings.trigger:
                    width_s = self.sensor.settings.exposure_s
                    self._wired = StrobeTrain(self._train.start_s + delay_s, period_s, width_s=width_s)
                self.bench.strobe(self._wired)
                return
            self._end_strobe()
            self._train = None
            self.stream_endpoint.discard()

    def _end_strobe(self) -> None:
        """End the edges on the line that is wired to the card, now."""
        train, self._wired = self._wired, None
        if train is not None:
            self.bench.strobe(replace(train, end_s=self.bench.clock.now_s()))

    def _enable(self, on: bool) -> None:
        del on
        self.stream_endpoint.discard()

    def _shot(self, frame: int, train: StrobeTrain) -> Shot:
        settings = self.sensor.settings
        return Shot(
            frame,
            train.start_s + frame * train.period_s,
            self.sensor.region,
            settings.exposure_s,
            self.sensor.line_period_s,
            train.period_s,
            settings.gain_db,
            self._skipped,
        )

    def _ticks(self, time_s: float) -> int:
        return round(time_s * 1e9)

    # Stream.

    def read_stream(self, buffer: array[int], timeout_s: float) -> int:
        """Fill a buffer with the next packets, in the simulator's own thread: :meth:`StreamEndpoint.read`."""
        return self._simulation.submit(self.stream_endpoint.read, buffer, timeout_s).result()

    def _payload_bytes(self) -> int:
        return self.sensor.settings.rows * self.sensor.settings.cols

    def _next_block(self) -> Iterator[Transfer] | None:
        """Return the transfers of the next frame; None while no frame is taken."""
        with self._lock:
            train = self._train
        if train is None or not self.stream.enabled or self.sensor.settings.trigger:
            return None
        self._skip_lost_frames(train)
        shot, self._frame = self._shot(self._frame, train), self._frame + 1
        return self._transfers(shot, self.stream.transfer_sizes)

    def _transfers(self, shot: Shot, sizes: list[int]) -> Iterator[Transfer]:
        """Leader, payload in the sizes that the host has set, trailer (USB3 Vision 1.0.1, image payload)."""
        yield _whole(self._leader(shot), shot.row_zero_s)
        payload = self._payload(shot)
        sent = payload[: len(payload) // 2] if self.faults.take("short_frames") else payload
        at = 0
        for room in sizes:
            part = sent[at : at + room]
            yield Transfer(part, room, shot.read_out_s)
            at += len(part)
            if len(part) < room:
                break
        status = standard.DATA_OVERRUN if at < len(sent) else standard.SUCCESS
        status = standard.DATA_DISCARDED if self.faults.take("bad_trailers") else status
        valid = min(at, len(payload)) if status == standard.DATA_OVERRUN else len(payload)
        yield _whole(self._trailer(shot, status, valid), shot.read_out_s)

    def _leader(self, shot: Shot) -> bytes:
        return standard.leader(shot.frame, self._ticks(shot.row_zero_s), shot.region)

    def _trailer(self, shot: Shot, status: int, valid_bytes: int) -> bytes:
        return standard.trailer(shot.frame, status, valid_bytes, shot.region[2])

    def _payload(self, shot: Shot) -> NDArray[np.uint8]:
        """Expose a frame."""
        rows, cols = shot.region[2:]
        if len(self._pixels) != rows * cols:
            self._pixels = np.zeros(rows * cols, np.uint8)
        self.bench.expose(shot, self._pixels.reshape(rows, cols))
        return self._pixels

    def _skip_lost_frames(self, train: StrobeTrain) -> None:
        clock = self.bench.clock
        shot = self._shot(self._frame, train)
        late = int((clock.now_s() - shot.read_out_s) / train.period_s)
        kept = BYTES_KEPT // (shot.region[2] * shot.region[3])
        if clock.real_time and late >= LATE_FRAMES:
            outdated_s = 0.0 if self._moved_s is None else max(self._moved_s() - shot.read_out_s, 0.0)
            skipped = max(late - kept, min(late, ceil(outdated_s / train.period_s)), 0)
            self._frame, self._skipped = self._frame + skipped, self._skipped + skipped
        if self.faults.drop_frames:
            self._frame += self.faults.drop_frames
            self.faults.drop_frames = 0


def _whole(data: bytes, due_s: float) -> Transfer:
    """Return a leader or trailer as a transfer: one short packet."""
    return Transfer(np.frombuffer(data, np.uint8), len(data), due_s)


def _begin_simulation() -> None:
    """Name the simulator's thread, so that its processor time is not counted with that of the drivers."""
    threading.current_thread().name = "simulated camera"
    join_frame_core(Rank.REST)
