"""Fixtures of the hardware tests: virtual devices below the real drivers, by every way in which these reach them."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial

import numpy as np
import pytest
from numpy.typing import NDArray

from camera_description import add_description
from faulty_camera import FaultyCamera
from napari_elsplus.hardware.daq.output import CardSettings
from napari_elsplus.hardware.protocols import FrameInfo
from napari_elsplus.hardware.scan.waveform import GalvoLimits
from napari_elsplus.hardware.u3v.camera import U3vCamera
from napari_elsplus.hardware.u3v.discovery import choose_camera
from napari_elsplus.hardware.u3v.flea3 import Flea3
from napari_elsplus.hardware.virtual.camera.bus import Plug, VirtualBus
from napari_elsplus.hardware.virtual.camera.device import Shot
from napari_elsplus.hardware.virtual.card.card import VirtualCard
from napari_elsplus.hardware.virtual.card.grpc_server import CardServer
from napari_elsplus.hardware.virtual.timeline import BenchClock, StrobeTrain
from napari_elsplus.instrument.calibration import Calibration
from ni_library import replacing_ni_library
from sfnc_camera import StandardRegisters

LINE_PERIOD_S = 1 / 130_750.6
PARK_V = -0.7
PERIOD_S = 1 / 240
WIDTH_S = 3 * LINE_PERIOD_S


@dataclass
class CardBench:
    """A virtual card, and the settings that reach it."""

    card: VirtualCard
    settings: CardSettings
    limits: GalvoLimits = field(default_factory=GalvoLimits)

    def strobe_now(self) -> StrobeTrain:
        train = StrobeTrain(time.perf_counter() + 1e-3, PERIOD_S, width_s=WIDTH_S)
        self.card.strobe(train)
        return train


@pytest.fixture(params=["grpc", "library"])
def cards(request: pytest.FixtureRequest) -> Iterator[Callable[..., CardBench]]:
    """Makes card benches; nidaqmx reaches them by gRPC, or through what it takes for NI's library."""
    card = VirtualCard()
    if request.param == "grpc":
        with CardServer(card) as server:
            yield lambda **changes: CardBench(card, CardSettings(PARK_V, address=server.address, **changes))
            _heal(card)
    else:
        with replacing_ni_library(card):
            yield lambda **changes: CardBench(card, CardSettings(PARK_V, **changes))
            _heal(card)


def _heal(card: VirtualCard) -> None:
    """End every fault, and wait until scanners that still try to park have."""
    card.break_with(0)
    card.inject(refuse_until_s=0.0, clear_errors=0, stuck=False, hangs=False)
    _wait_for(lambda: "galvo watch" not in {thread.name for thread in threading.enumerate()}, 10.0)


class PlainBench:
    """A sensor that shows the frame's number in every pixel."""

    def __init__(self, real_time: bool = True) -> None:
        self.clock = BenchClock(real_time)
        self.trains: list[StrobeTrain | None] = []
        self.shots: list[Shot] = []

    def strobe(self, train: StrobeTrain | None) -> None:
        self.trains.append(train)

    def prepare(self, shot: Shot) -> None:
        pass

    def expose(self, shot: Shot, out: NDArray[np.uint8]) -> None:
        self.shots.append(shot)
        out[:] = shot.frame % 251
        out[0, 0], out[-1, -1] = 252, 253


def read_frames(camera: U3vCamera, count: int, timeout_s: float = 3.0) -> list[FrameInfo]:
    """Read frames of a `PlainBench`, and check that each is neither shifted nor cut."""
    buffer = np.empty(camera.frame_shape, np.uint8)
    infos = []
    for _ in range(count):
        infos.append(camera.read_into(buffer, timeout_s))
        assert (buffer.ravel()[1:-1] == infos[-1].frame_number % 251).all()
        assert (buffer[0, 0], buffer[-1, -1]) == (252, 253)
    return infos


@dataclass
class CameraBench:
    """A virtual camera on a virtual bus."""

    bench: PlainBench
    plug: Plug
    bus: VirtualBus

    def open(self, *, wait_for_reader: bool = False, **features: float) -> U3vCamera:
        device = choose_camera("", self.bus)
        return U3vCamera(device, partial(Flea3, **features), wait_for_reader=wait_for_reader)


@pytest.fixture
def cameras() -> Callable[..., CameraBench]:
    def make(real_time: bool = True, **camera: object) -> CameraBench:
        bench = PlainBench(real_time)
        device = FaultyCamera(bench, **{"serial": "4711", **camera})
        add_description(device, device.make.describe() if isinstance(device.make, StandardRegisters) else None)
        plug = Plug(device)
        return CameraBench(bench, plug, VirtualBus(plug))

    return make


def _calibration(
    offset: float = -22.0, diameter: float = 465.0, centre: float = 273.0, slope: float = 0.00175, lag_s: float = 2e-4
) -> Calibration:
    """A bundle pair as in the 240 Hz mode, and a galvo map."""
    return Calibration.parse(
        {
            "bundle": {
                "diameter_px": diameter,
                "confocal_centre": [centre, 332],
                "residual_centre": [centre + offset, 996],
                "residual_to_confocal": [[1, 0, -offset], [0, 1, -664]],
            },
            "galvo": {
                "volts_per_row": slope,
                "volts_at_row_zero": -0.459,
                "r_squared": 1,
                "rms_rows": 0,
                "lag_s": lag_s,
            },
            "offset": {"rows": offset, "uncertainty_rows": 0.01},
        }
    )


def _wait_for(condition: Callable[[], bool], within_s: float = 3.0) -> float:
    """Wait until a condition holds; return how long it took."""
    begin = time.perf_counter()
    while not condition():
        assert time.perf_counter() - begin < within_s, "it never came to that"
        time.sleep(1e-3)
    return time.perf_counter() - begin


@pytest.fixture(scope="session")
def calibration() -> Callable[..., Calibration]:
    """Makes calibrations of a bundle pair and a galvo."""
    return _calibration


@pytest.fixture(scope="session")
def wait_for() -> Callable[..., float]:
    """Waits until a condition holds, and says how long it took."""
    return _wait_for
