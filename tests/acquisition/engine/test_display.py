"""The display's rings: replaced whole or not at all, closed once."""

from __future__ import annotations

import pytest

from napari_elsplus.acquisition.engine.display import Display, on_the_heap
from napari_elsplus.acquisition.engine.engine import Engine
from napari_elsplus.acquisition.engine.live_images import LiveView
from napari_elsplus.acquisition.streaming.ring import Layout, Ring
from napari_elsplus.acquisition.streaming.shared_memory import SharedRing

SHAPES = (40, 60), (50, 60)


def test_a_ring_that_cannot_be_made_leaves_the_display_as_it_was() -> None:
    """Before: the ring in use was retired all the same, closed at the next stop, and written to after that."""
    fails = False

    def make(layout: Layout) -> tuple[str, Ring]:
        if fails:
            raise OSError(28, "No space left on device")
        return on_the_heap(layout)

    display = Display(make)
    sink = display.renew(SHAPES[0], None, LiveView())
    fails = True
    with pytest.raises(OSError, match="No space"):
        display.renew(SHAPES[1], None, LiveView())
    display.close_retired()
    assert display.sink is sink
    slot = sink.ring.acquire()
    sink.ring.finalize(slot, frame_number=1, received_s=0.0, readout_start_s=0.0)
    fails = False
    assert display.renew(SHAPES[1], None, LiveView()).ring is not sink.ring
    display.close()


@pytest.mark.parametrize("make", [on_the_heap, lambda layout: ("", SharedRing.create(layout))])
def test_a_ring_is_closed_once_however_often_it_is_asked(make) -> None:
    """Before: AttributeError, the second time."""
    display = Display(make)
    ring = display.renew(SHAPES[0], None, LiveView()).ring
    ring.close()
    display.close()
    assert ring.newest_after(-1, {}) is None


def test_a_galvo_that_is_not_parked_is_said_though_the_display_fails(engine: Engine, monkeypatch) -> None:
    """Before: the display came first, and what to do by hand was not said."""
    closed = []
    monkeypatch.setattr(engine.galvo, "close", lambda: closed.append("galvo"))

    def failing() -> None:
        raise OSError("a defect of shared memory")

    monkeypatch.setattr(engine._imaging.display, "close", failing)
    with pytest.raises(OSError, match="a defect"):
        engine.close()
    assert closed == ["galvo"]
