"""The display's rings: replaced whole or not at all, closed once."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest

from napari_elsplus.acquisition.engine.display import Display, on_the_heap
from napari_elsplus.acquisition.engine.engine import Engine
from napari_elsplus.acquisition.engine.live_images import LiveView
from napari_elsplus.acquisition.engine.status import Settings
from napari_elsplus.acquisition.streaming.ring import Layout, Ring
from napari_elsplus.acquisition.streaming.shared_memory import SharedRing
from napari_elsplus.hardware.protocols import FrameInfo
from napari_elsplus.instrument.calibration import Calibration
from napari_elsplus.processing.images.sectioning import Mode

if TYPE_CHECKING:
    from collections.abc import Callable


def display_of(make: Callable[[Layout], Ring]) -> tuple[Display, Any]:
    setup: Any = SimpleNamespace(configured=True, frame_shape=(40, 60))
    display = Display(setup, make)
    display.renew()
    return display, setup


def test_a_ring_that_cannot_be_made_leaves_the_display_as_it_was() -> None:
    """Before: the ring in use was retired all the same, closed at the next stop, and written to after that."""
    fails = False

    def make(layout: Layout) -> Ring:
        if fails:
            raise OSError(28, "No space left on device")
        return on_the_heap(layout)

    display, setup = display_of(make)
    sink = display.sink
    assert sink is not None
    fails, setup.frame_shape = True, (50, 60)
    with pytest.raises(OSError, match="No space"):
        display.renew()
    display.close_retired()
    assert display.sink is sink
    slot = sink.ring.acquire()
    sink.ring.finalize(slot, FrameInfo(1, 0.0, 0.0))
    fails = False
    display.renew()
    assert display.sink.ring is not sink.ring
    display.close()


@pytest.mark.parametrize("make", [on_the_heap, SharedRing.create])
def test_a_ring_is_closed_once_however_often_it_is_asked(make) -> None:
    """Before: AttributeError, the second time."""
    display, _ = display_of(make)
    assert display.sink is not None
    ring = display.sink.ring
    ring.close()
    display.close()
    assert ring.newest_after(-1, {}) is None


def test_a_galvo_that_is_not_parked_is_said_though_the_display_fails(engine: Engine, monkeypatch) -> None:
    """Before: the display came first, and what to do by hand was not said."""
    closed = []
    monkeypatch.setattr(engine.galvo, "close", lambda: closed.append("galvo"))

    def failing() -> None:
        raise OSError("a defect of shared memory")

    monkeypatch.setattr(engine._display, "close", failing)
    with pytest.raises(OSError, match="a defect"):
        engine.close()
    assert closed == ["galvo"]


def test_the_view_can_be_changed_while_the_calibration_does_not_fit(engine: Engine, calibration: Calibration) -> None:
    """Before: refused for the misfit, and the view of before came back with frames that fit."""
    engine.use(Calibration.parse({**calibration.content(), "frame": {"shape": [524, 1328], "sensor_origin": [262, 0]}}))
    engine.configure(Settings("120hz", frame_rate_hz=100.0))
    engine.show(LiveView(modes=frozenset({Mode.LS})))
    assert engine.display is not None
    assert [name for name, *_ in engine.display.layout.fields] == ["raw"]
    engine.configure(Settings("240hz", frame_rate_hz=100.0))
    assert [name for name, *_ in engine.display.layout.fields] == ["raw", "ls"]
