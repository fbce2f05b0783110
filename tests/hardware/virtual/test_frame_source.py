from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from napari_elsplus.hardware.virtual.frame_source import Circle, FrameSource
from napari_elsplus.hardware.virtual.remembered_frames import MAX_FILES
from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.simulation.specimen.scenes import plate


def test_frames_come_again_from_memory_while_the_line_moves_alike_and_only_then() -> None:
    instrument = Instrument.of("240hz")
    source = FrameSource(instrument, plate(0.0), Circle(period_s=4 / 240), seed=0, ahead=True)
    rows = np.arange(instrument.frame_shape[0], dtype=np.float64)
    out = np.empty(instrument.frame_shape, np.uint8)

    def frame(number: int, late_rows: float) -> np.ndarray:
        source.fill(number, out, rows - late_rows)
        return out.copy()

    source.render_ahead(rows - 0.4)
    first = [frame(number, 0.4) for number in range(4)]
    again = [frame(number, 0.4) for number in range(4, 8)]
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first[0], first[1])
    missed = frame(8, 8.0)
    assert missed.mean() < 0.9 * first[0].mean()
    assert frame(9, 8.0).mean() < 0.9 * first[0].mean()
    assert frame(10, 0.4).mean() > 0.95 * first[2].mean()


def test_a_second_start_recalls_the_frames_of_a_closed_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ELSPLUS_CACHE", str(tmp_path))
    instrument = Instrument.of("240hz")
    rows = np.arange(instrument.frame_shape[0], dtype=np.float64)
    frame = np.empty(instrument.frame_shape, np.uint8)

    def started(seed: int = 0, late_rows: float = 0.4) -> tuple[int, np.ndarray]:
        """Number of frames rendered at a start, and a frame."""
        source = FrameSource(instrument, plate(0.0), Circle(period_s=3 / 240), seed=seed, ahead=True)
        rendered = []
        render = source._renderer.render
        source._renderer.render = lambda k, *a, **b: (rendered.append(k), render(k, *a, **b))[1]
        source.render_ahead(rows - late_rows)
        source.fill(4, frame, rows - late_rows)
        return len(rendered), frame.copy()

    first, again = started(), started()
    assert (first[0], again[0]) == (4, 1)  # one is always rendered, so that everything is compiled
    np.testing.assert_array_equal(first[1], again[1])
    assert started(seed=1)[0] == started(late_rows=0.8)[0] == 4
    assert started(late_rows=0.41)[0] == 1  # to within the noise the same line
    for file in tmp_path.rglob("*.npy"):
        file.write_bytes(file.read_bytes()[:-1])
    assert started()[0] == 4
    assert len(list(tmp_path.rglob("*.npy"))) <= MAX_FILES
