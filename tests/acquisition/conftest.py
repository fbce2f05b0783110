"""The engine of these tests, on a rig of a few lines."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from napari_elsplus.acquisition.engine.engine import Engine
from napari_elsplus.acquisition.engine.status import Settings
from napari_elsplus.instrument.calibration import Calibration
from small_rig import SmallRig, small_calibration


@pytest.fixture
def calibration() -> Calibration:
    return small_calibration()


@pytest.fixture
def rig() -> SmallRig:
    return SmallRig()


@pytest.fixture
def engine(rig: SmallRig) -> Iterator[Engine]:
    """An engine on the small rig, configured at a rate that leaves time for other tests' work."""
    with Engine(rig, buffer_s=1.0) as engine:
        engine.configure(Settings("240hz", frame_rate_hz=100.0))
        yield engine
    assert rig.scanner.calls[-1] == "close"
    assert rig.scanner.volts == rig.scanner.park_v
    assert not rig.camera.streams
