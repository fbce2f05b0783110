"""Presets on cameras of other sensors, and on a slow bus: the region in the middle, the rate that is carried."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import pytest

from napari_elsplus.acquisition.engine.camera_setup import CameraSetup
from napari_elsplus.acquisition.engine.engine import Engine
from napari_elsplus.acquisition.engine.status import Settings
from napari_elsplus.errors import InputError
from napari_elsplus.hardware.virtual.camera.iidc import Flea3Registers
from virtual_devices import cameras

__all__ = ["cameras"]


def of_sensor(rows: int, cols: int, **changes: object) -> type[Flea3Registers]:
    """A make of camera that differs from the Flea3 by its sensor."""
    return type("Other", (Flea3Registers,), {"model": replace(Flea3Registers.model, shape=(rows, cols), **changes)})


@pytest.fixture
def setup(cameras):
    """Makes the setup of a camera that does not keep time, with the camera's bench."""
    opened = []

    def make(**changes):
        bench = cameras(real_time=False, **changes)
        opened.append(bench.open(wait_for_reader=True))
        return CameraSetup(SimpleNamespace(name="other", camera=opened[-1]))

    yield make
    for camera in opened:
        camera.close()


@pytest.mark.parametrize(
    ("sensor", "preset", "origin", "shape"),
    [
        ((1048, 1328), "240hz", (262, 0), (524, 1328)),
        ((1048, 1328), "120hz", (0, 0), (1048, 1328)),
        ((960, 1280), "240hz", (218, 0), (524, 1280)),
        ((1200, 1936), "240hz", (338, 304), (524, 1328)),
        ((1200, 1936), "120hz", (76, 304), (1048, 1328)),
        ((500, 960), "240hz", (0, 0), (500, 960)),
    ],
)
def test_a_preset_reads_the_middle_of_the_sensor(setup, sensor, preset, origin, shape) -> None:
    chosen = setup(make=of_sensor(*sensor))
    chosen.configure(Settings(preset, frame_rate_hz=50.0))
    assert chosen.camera.frame_shape == shape
    assert chosen.frame.shape == shape
    assert chosen.frame.sensor_origin == origin


def test_a_sensor_too_small_for_both_views_is_refused_with_what_fits(setup) -> None:
    with pytest.raises(InputError, match="960 x 1280: the two views of the bundle take 646 x 1291 pixels: 240hz fits"):
        setup(make=of_sensor(960, 1280)).configure(Settings("120hz"))
    with pytest.raises(InputError, match=r"480 x 640.* 465 x 930 pixels: use a camera with a larger sensor"):
        setup(make=of_sensor(480, 640)).configure(Settings("240hz"))


def test_the_default_rate_is_the_highest_that_the_camera_takes_and_a_notice_says_so(setup) -> None:
    slower = setup(make=of_sensor(1048, 1328, line_rate_hz=130_750.6 * 0.75))
    slower.camera._features._line_rate_hz = 130_750.6 * 0.75
    slower.configure(Settings("240hz"))
    assert slower.frame_rate_hz == pytest.approx(180.0, rel=1e-4)
    assert slower.acquired_with.frame_rate_hz == pytest.approx(180.0, rel=1e-4)
    assert slower.notice == "180.0 instead of 240 frames per second: the camera takes no more in this region"
    with pytest.raises(InputError, match="frame rate of 240 Hz"):
        slower.configure(Settings("240hz", frame_rate_hz=240.0))


def test_the_papers_camera_runs_at_the_presets_rate_without_a_notice(setup) -> None:
    chosen = setup()
    for preset, rate_hz in (("240hz", 240.0), ("120hz", 120.0)):
        chosen.configure(Settings(preset))
        assert (chosen.acquired_with.frame_rate_hz, chosen.notice) == (rate_hz, "")


@pytest.mark.parametrize("rate_hz", [None, 100.0])
def test_on_a_slow_bus_the_default_rate_is_what_it_carries_and_a_chosen_one_is_kept(cameras, rig, rate_hz) -> None:
    bench = cameras()
    bench.plug.camera.faults.bus_bytes_per_s = 60e6  # 86.2 of 240 frames per second
    rig.camera = bench.open()
    with Engine(rig, buffer_s=0.5) as engine:
        engine.configure(Settings("240hz", frame_rate_hz=rate_hz))
        engine.start(scan=False)
        status = engine.status()
        assert status.live
        assert not status.faults
        if rate_hz is not None:
            assert (engine.setup.frame_rate_hz, status.notice) == (pytest.approx(100.0), "")
            return
        assert 70 < engine.setup.frame_rate_hz < 0.96 * 60e6 / (524 * 1328)
        assert status.notice.endswith("instead of 240 frames per second: the bus carries no more")
        engine.fresh_frames(10)
        assert not engine.status().dropped
