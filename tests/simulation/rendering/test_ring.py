from __future__ import annotations

import numpy as np
import pytest

from napari_elsplus.errors import InputError
from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.simulation.rendering.renderer import Renderer
from napari_elsplus.simulation.rendering.ring import FrameLoop
from napari_elsplus.simulation.specimen.scenes import scene
from napari_elsplus.simulation.specimen.trajectories import Straight


def test_another_line_invalidates_the_ring_until_it_is_refilled() -> None:
    renderer = Renderer(Instrument.of("240hz"), scene("nuclei"), Straight())
    ring = FrameLoop(renderer, 3)
    rows = np.arange(renderer.frame_shape[0], dtype=float)
    late = rows + 5
    assert np.array_equal(ring.render(7, line_rows=rows), renderer.render(1))
    assert np.array_equal(ring.render(7, line_rows=late), renderer.render(7, line_rows=late))
    assert not ring.valid
    assert np.array_equal(ring.render(7), renderer.render(7))
    ring.refill(late)
    assert np.array_equal(ring.render(7, line_rows=late), renderer.render(1, line_rows=late))


def test_an_empty_ring_is_refused() -> None:
    with pytest.raises(InputError, match="ring of 0 frames"):
        FrameLoop(Renderer(Instrument.of("240hz"), scene("empty")), 0)
