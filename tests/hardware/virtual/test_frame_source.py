from __future__ import annotations

import numpy as np

from napari_elsplus.hardware.virtual.frame_source import Circle, FrameSource
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
