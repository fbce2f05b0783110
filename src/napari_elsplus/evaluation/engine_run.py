"""The live engine on the simulated rig, run for some time and measured: lateness, losses, processor time, memory."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Protocol, Self

import numpy as np

from napari_elsplus.acquisition.client import EngineClient
from napari_elsplus.acquisition.engine import Engine
from napari_elsplus.acquisition.live_images import RAW
from napari_elsplus.acquisition.priority import keep_pace, settle_memory
from napari_elsplus.acquisition.process import STATUS_PERIOD_S
from napari_elsplus.acquisition.recorder import RecordingPlan
from napari_elsplus.acquisition.simulated import open_live
from napari_elsplus.acquisition.status import Settings
from napari_elsplus.acquisition.tracking import LiveTrack
from napari_elsplus.hardware.rigs import SIMULATED
from napari_elsplus.hardware.virtual.bench import Simulation
from napari_elsplus.simulation.calibration_scenes import background
from napari_elsplus.simulation.instrument import Instrument
from napari_elsplus.simulation.truth import true_calibration

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from napari_elsplus.acquisition.ring import Ring
    from napari_elsplus.acquisition.status import Status
    from napari_elsplus.acquisition.tally import Latencies
    from napari_elsplus.acquisition.usage import Usage
    from napari_elsplus.calibration import Calibration

LOOK_S: Final = 1 / 60
SETTLE_S: Final = 3.0
"""Left out of processor time and memory: what a stream needs once."""
_MEMORY_EVERY_S: Final = 1.0


@dataclass(frozen=True)
class EngineRun:
    """What a run of the engine came to.

    Parameters
    ----------
    status : Status
        At the end.
    latencies : Latencies
        Of every frame.
    cpu_s : float
        Processor time of the engine's process, simulator included, while it was measured.
    measured_s : float
        How long that was.
    memory_mb : numpy.ndarray
        Once a second.
    looks : int
        How many different frames whoever looked on has seen while it was measured.
    """

    status: Status
    latencies: Latencies
    cpu_s: float
    measured_s: float
    memory_mb: np.ndarray[Any, np.dtype[np.float64]]
    looks: int

    @property
    def cpu_us_per_frame(self) -> float:
        """Processor time for each frame, microseconds."""
        return 1e6 * self.cpu_s / (self.measured_s * self.status.mean_hz)

    @property
    def growth_percent(self) -> float:
        """Memory in the last tenth of the run against the first, percent."""
        tenth = max(1, len(self.memory_mb) // 10)
        return 100 * float(np.median(self.memory_mb[-tenth:]) / np.median(self.memory_mb[:tenth]) - 1)

    @property
    def lost(self) -> int:
        """Frames lost, by whatever cause."""
        return sum(self.status.dropped.values())


class _Driven(Protocol):
    """An engine, wherever it runs; every call waits."""

    def __enter__(self) -> Self:
        """Return it."""

    def __exit__(self, *reason: object) -> Any:
        """Close it."""

    def begin(self, record: RecordingPlan | None) -> None:
        """Stream, and record if asked."""

    def end(self) -> None:
        """Stop; the recording is in order then."""

    def ring(self) -> Ring | None:
        """Return where images are shown."""

    def usage(self) -> Usage:
        """Return what its process has used."""

    def outcome(self) -> tuple[Status, Latencies]:
        """Return what was counted."""


class Here:
    """The engine in this process.

    Parameters
    ----------
    name : str
        Preset.
    track : bool
        Whether every frame is tracked and laid into a mosaic, too.
    """

    def __init__(self, name: str, *, track: bool = False) -> None:
        keep_pace()
        self._engine = engine = Engine(open_live(SIMULATED))
        engine.configure(Settings(name))
        calibration = _calibration(name)
        engine.use(calibration)
        self._track = LiveTrack(calibration, engine.setup.frame_shape) if track else None
        engine.track(self._track)
        settle_memory()

    def begin(self, record: RecordingPlan | None) -> None:
        """Stream."""
        self._engine.start()
        if record is not None:
            self._engine.record(record)

    def end(self) -> None:
        """Stop."""
        self._engine.stop()
        self._engine.finish_recording()

    def ring(self) -> Ring | None:
        """Return where images are shown."""
        return self._engine.display

    def usage(self) -> Usage:
        """Return what this process has used."""
        return self._engine.usage()

    def outcome(self) -> tuple[Status, Latencies]:
        """Return what was counted."""
        return self._engine.status(), self._engine.latencies()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *reason: object) -> Any:
        self._engine.close()
        if self._track is not None:
            self._track.close()


class Apart:
    """The engine in a process of its own, as napari uses it.

    Parameters
    ----------
    name : str
        Preset.
    """

    def __init__(self, name: str) -> None:
        self._client = client = EngineClient()
        client.open(SIMULATED).result()
        client.configure(Settings(name)).result()
        client.use(_calibration(name)).result()

    def begin(self, record: RecordingPlan | None) -> None:
        """Stream."""
        self._client.start().result()
        if record is not None:
            self._client.record(record).result()

    def end(self) -> None:
        """Stop."""
        self._client.stop_recording().result()
        self._client.stop().result()

    def ring(self) -> Ring | None:
        """Return where images are shown."""
        return self._client.display()

    def usage(self) -> Usage:
        """Return what the engine's process has used."""
        return self._client.usage().result()

    def outcome(self) -> tuple[Status, Latencies]:
        """Return what was counted."""
        latencies = self._client.latencies().result()
        time.sleep(2 * STATUS_PERIOD_S)  # it says by itself how it went
        return self._client.status, latencies

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *reason: object) -> Any:
        self._client.close()


def run_engine(
    engine: _Driven,
    seconds: float,
    *,
    record: Path | None = None,
    settle_s: float = SETTLE_S,
    between: Callable[[], None] = lambda: None,
) -> EngineRun:
    """Stream for some time, looking at the newest images 60 times a second.

    Parameters
    ----------
    engine : Here or Apart
        Ready; closed afterwards.
    seconds : float
        How long, after it has settled.
    record : Path, optional
        Record into that file, too, the two seconds before included.
    settle_s : float
        How long to wait before processor time and memory are measured.
    between : callable
        What else whoever looks on has to do after each look.
    """
    plan = None if record is None else RecordingPlan(record, earlier_s=2.0, force=True)
    with engine:
        engine.begin(plan)
        watched = _Look(engine, between)
        watched.go_on(settle_s)
        watched.seen = 0
        before, begin_s = engine.usage(), time.perf_counter()
        memory = [before.memory_mb]
        while (left_s := begin_s + seconds - time.perf_counter()) > 0:
            watched.go_on(min(left_s, _MEMORY_EVERY_S))
            memory.append(engine.usage().memory_mb)
        after, end_s = engine.usage(), time.perf_counter()
        engine.end()
        status, latencies = engine.outcome()
    return EngineRun(status, latencies, after.cpu_s - before.cpu_s, end_s - begin_s, np.array(memory), watched.seen)


class _Look:
    """Whoever looks on: copies LS and ELS+ as a window does."""

    def __init__(self, engine: _Driven, between: Callable[[], None]) -> None:
        self._engine, self._between = engine, between
        self._sequence, self.seen = -1, 0
        self._out: dict[str, Any] = {}

    def go_on(self, seconds: float) -> None:
        until_s = time.perf_counter() + seconds
        while (now_s := time.perf_counter()) < until_s:
            ring = self._engine.ring()
            if ring is not None:
                self._copy(ring)
            self._between()
            time.sleep(max(0.0, min(now_s + LOOK_S, until_s) - time.perf_counter()))

    def _copy(self, ring: Ring) -> None:
        fields = [field for field in ring.layout.fields if field[0] != RAW]
        if self._out.keys() != {name for name, _, _ in fields}:
            self._out = {name: np.empty(shape, dtype) for name, shape, dtype in fields}
        stamp = ring.newest_after(self._sequence, self._out)
        if stamp is not None:
            self._sequence, self.seen = stamp.sequence, self.seen + 1


def _calibration(name: str) -> Calibration:
    """Return what a perfect calibration of the simulated rig would say."""
    simulation = Simulation()
    instrument = Instrument.of(name, offset_um=simulation.offset_um)
    perfect = true_calibration(instrument, background(instrument))
    assert perfect.galvo is not None
    galvo = perfect.galvo.model_copy(update={"lag_s": simulation.galvo.lag_s})
    return perfect.model_copy(update={"galvo": galvo})
