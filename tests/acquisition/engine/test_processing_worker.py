from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from napari_elsplus.acquisition.engine.display import DisplaySink
from napari_elsplus.acquisition.engine.live_images import LiveImages, LiveView
from napari_elsplus.acquisition.engine.workers import ProcessingWorker
from napari_elsplus.acquisition.streaming.faults import FaultLog
from napari_elsplus.acquisition.streaming.ring import Ring
from napari_elsplus.acquisition.streaming.stream import FrameStream
from napari_elsplus.acquisition.streaming.tally import Tally
from napari_elsplus.errors import InputError
from napari_elsplus.hardware.protocols import FrameInfo
from napari_elsplus.instrument.calibration import Calibration
from napari_elsplus.processing.images.sectioning import Mode, Sectioner

SHAPE = (60, 120)
BUNDLE = {
    "confocal_centre": [30, 30],
    "residual_centre": [30, 90],
    "diameter_px": 40,
    "residual_to_confocal": [[1, 0, 0], [0, 1, -60]],
}


@pytest.mark.parametrize(("modes", "sectioned"), [(set(Mode) - {Mode.ELSA}, [1]), (set(Mode), [2, 3])])
@pytest.mark.parametrize("tracked", [True, False])
def test_only_frames_that_are_displayed_are_sectioned(
    monkeypatch: pytest.MonkeyPatch, tracked: bool, modes: set[Mode], sectioned: list[int]
) -> None:
    images = LiveImages(SHAPE, Calibration.parse({"bundle": BUNDLE}), LiveView(modes=frozenset(modes)))
    added: list[int] = []
    monkeypatch.setattr(Sectioner, "fill", lambda _, raw, *views, **images: added.append(int(raw[0, 0])))
    ring = Ring(bytearray(images.layout.nbytes), images.layout)
    stream, tally, late_s = FrameStream(SHAPE, 64), Tally(), list[float]()
    monkeypatch.setattr(tally.latency, "add", late_s.append)
    tracker: Any = SimpleNamespace(add=lambda raw, stamp: None) if tracked else None
    display: Any = SimpleNamespace(sink=DisplaySink(images, ring))
    worker = ProcessingWorker(stream, display, tally, FaultLog(), tracker)
    worker.start()
    deadline_s, stamp = time.perf_counter() + 10, None
    for number in range(1, sectioned[-1] + 1):
        slot = stream.acquire()
        slot.arrays["raw"][...] = number
        stream.finalize(slot, FrameInfo(number, time.perf_counter(), 0.0))
    while stamp is None and time.perf_counter() < deadline_s:
        stamp = ring.newest_after(-1, {"raw": np.empty(SHAPE, np.uint8)})
    assert added == sectioned
    assert stamp is not None
    assert stamp.frame_number == sectioned[-1]
    stream.end()
    worker.join(10)
    assert tally.processed == sectioned[-1]
    assert len(late_s) == (sectioned[-1] if tracked else 1)


def test_images_of_one_frame_are_sectioned_into_the_ring_and_a_failure_is_a_fault(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    modes = frozenset({Mode.LS, Mode.ELS})
    images = LiveImages(SHAPE, Calibration.parse({"bundle": BUNDLE}), LiveView(modes=modes))
    ring = Ring(bytearray(images.layout.nbytes), images.layout)
    filled: list[Any] = []

    def failing(*_: Any, ls: Any, els: Any, residual: Any) -> None:
        filled.extend((ls, els, residual))
        raise InputError("no image", "take another frame")

    monkeypatch.setattr(Sectioner, "fill", failing)
    stream, tally, faults = FrameStream(SHAPE, 64), Tally(), FaultLog()
    display: Any = SimpleNamespace(sink=DisplaySink(images, ring))
    worker = ProcessingWorker(stream, display, tally, faults, None)
    worker.start()
    slot = stream.acquire()
    stream.finalize(slot, FrameInfo(0, time.perf_counter(), 0.0))
    stream.end()
    worker.join(10)
    first = ring.acquire().arrays
    assert np.shares_memory(filled[0], first["ls"])
    assert np.shares_memory(filled[1], first["els"])
    assert filled[2] is None
    assert tally.processed == 1
    assert [fault.problem for fault in faults.all()] == ["no image"]
