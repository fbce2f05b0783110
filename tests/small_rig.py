"""A rig of a few lines for tests of the engine: frames that say their own number, a mirror that remembers."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from napari_elsplus.errors import DeviceError, InputError
from napari_elsplus.hardware.parking import ParkStage, ParkState
from napari_elsplus.hardware.protocols import FrameInfo, Region
from napari_elsplus.hardware.scan.timing import StrobePhase
from napari_elsplus.hardware.scan.waveform import GalvoLimits, Waveform
from napari_elsplus.instrument.calibration import Calibration

PARK_V = -0.7


def frame_number_in(frame: NDArray[np.uint8]) -> int:
    """The number that the camera wrote into the first pixels."""
    return int(np.ascontiguousarray(frame[0, :8]).view(np.int64)[0])


@dataclass
class PacedCamera:
    """Frames at an even pace; the first pixels hold the frame's number."""

    rate_hz: float = 240.0
    skipped_numbers: set[int] = field(default_factory=set)
    unplugged_at: int | None = None
    shape: tuple[int, int] = (0, 0)
    streams: bool = False
    dropped: dict[str, int] = field(default_factory=dict)
    line_period_s: float = 7.648e-6

    @property
    def frame_shape(self) -> tuple[int, int]:
        return self.shape

    @property
    def line_periods_per_frame(self) -> float:
        return 1 / (self.rate_hz * self.line_period_s)

    def configure(self, region: Region, *, slit_rows: int, frame_rate_hz: float, gain_db: float = 0.0) -> None:
        if self.streams:
            raise DeviceError("the camera streams", "stop it first")
        if slit_rows > 100:
            raise InputError(f"a slit of {slit_rows} rows", "choose a smaller one")
        self.shape, self.rate_hz = region.shape, frame_rate_hz
        across = np.linspace(0, 6 * np.pi, region.cols)
        waves = 70 + 50 * np.sin(across) * np.sin(across[: region.rows, None])
        blocks = np.random.default_rng(0).integers(0, 80, (region.rows // 12 + 1, region.cols // 12 + 1))
        grain = blocks.repeat(12, axis=0).repeat(12, axis=1)[: region.rows, : region.cols]  # something to be tracked by
        self.picture = (waves + grain).astype(np.uint8)

    def start(self) -> None:
        self.streams, self.number, self.dropped = True, -1, {}
        self.begin_s = time.perf_counter()

    def read_into(self, buffer: NDArray[np.uint8], timeout_s: float) -> FrameInfo:
        self.number += 1
        while self.number in self.skipped_numbers:
            self.number += 1
            self.dropped["gap"] = self.dropped.get("gap", 0) + 1
        if self.number == self.unplugged_at:
            self.streams = False
            raise DeviceError("the camera was unplugged", "plug it in and connect again")
        due_s = self.begin_s + (self.number + 1) / self.rate_hz
        time.sleep(max(0.0, due_s - time.perf_counter()))
        buffer[...] = self.picture
        buffer[0, :8] = np.array([self.number], np.int64).view(np.uint8)
        return FrameInfo(self.number, due_s, self.number / self.rate_hz)

    def stop(self) -> None:
        self.streams = False

    def close(self) -> None:
        self.stop()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *reason: object) -> None:
        self.close()


@dataclass
class RememberingScanner:
    """Puts out nothing, remembers what it was asked."""

    calls: list[str] = field(default_factory=list)
    volts: float = PARK_V
    park_v: float = PARK_V
    fault: DeviceError | None = None
    ramps_begun: int = 0

    @property
    def park_state(self) -> ParkState:
        return ParkState(ParkStage.PARKED if self.volts == self.park_v else ParkStage.DRIVEN)

    def on_park_state(self, callback: Callable[[ParkState], None]) -> Callable[[], None]:
        return lambda: None

    def watch_frames(self, received: Callable[[], int] | None) -> None:
        pass

    def park_at(self, volts: float) -> None:
        if abs(volts) > 2:
            raise InputError(f"{volts} V asked of the parking position", "the limits are -2 to 2 V")
        self.park_v = volts

    def hold(self, volts: float) -> None:
        self.calls.append("hold")
        self.volts = volts

    def scan(self, waveform: Waveform) -> None:
        self.calls.append("scan")
        self.volts = float(waveform.volts[0])

    def check(self) -> None:
        if self.fault is not None:
            fault, self.fault = self.fault, None
            raise fault

    def park(self) -> None:
        self.calls.append("park")
        self.volts = self.park_v

    def close(self) -> None:
        self.park()
        self.calls.append("close")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *reason: object) -> None:
        self.close()


@dataclass
class SmallRig:
    """A camera and a mirror, as `open_rig` gives them."""

    name: str = "small"
    camera: PacedCamera = field(default_factory=PacedCamera)
    scanner: RememberingScanner = field(default_factory=RememberingScanner)
    limits: GalvoLimits = field(default_factory=GalvoLimits)
    strobe: StrobePhase = StrobePhase.EXPOSURE
    guardian: None = None
    bench: None = None

    def check_guarded(self) -> None:
        if self.guardian is not None:
            self.guardian.check()

    def close(self) -> None:
        self.scanner.close()
        self.camera.close()


def small_calibration() -> Calibration:
    """A calibration of the 240 Hz preset."""
    content: dict[str, Any] = {
        "bundle": {
            "confocal_centre": [262.0, 330.0],
            "residual_centre": [250.0, 990.0],
            "diameter_px": 464.0,
            "residual_to_confocal": [[1.0, 0.0, 12.0], [0.0, 1.0, -660.0]],
        },
        "galvo": {"volts_per_row": 0.00126, "volts_at_row_zero": -0.3, "r_squared": 1.0, "rms_rows": 0.0},
        "optics": {"um_per_px": 1.33, "line_period_s": 7.648e-6, "rows_per_frame": 544.8},
    }
    return Calibration.parse(content)
