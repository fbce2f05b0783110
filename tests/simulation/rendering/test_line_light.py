"""The light of a jittering line is that of a line on the jittered rows, and is not computed in every frame."""

from __future__ import annotations

import numpy as np
import pytest

from napari_elsplus.simulation.model.axial_response import LINE_MODELS
from napari_elsplus.simulation.model.imperfections import Imperfections
from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.simulation.rendering.disturbances import Disturbances
from napari_elsplus.simulation.rendering.line_light import COMPUTED_FRAMES, MAX_JITTER_ROWS
from napari_elsplus.simulation.rendering.renderer import Renderer
from napari_elsplus.simulation.rendering.scan import LineScan
from napari_elsplus.simulation.specimen.scenes import fibres, uniform


def made(jitter_rows: float, scene, state: str = "b") -> Renderer:
    given = Imperfections.of({"line-jitter": jitter_rows} if jitter_rows else {})
    return Renderer(Instrument.of("240hz", imperfections=given, line=LINE_MODELS[state]), scene, seed=3)


@pytest.mark.parametrize("standing", [False, True], ids=["scanned", "standing"])
@pytest.mark.parametrize("jitter_rows", [0.5, 2 * MAX_JITTER_ROWS])
def test_a_frame_is_that_of_a_line_on_the_jittered_rows(jitter_rows: float, standing: bool) -> None:
    jittering, steady = made(jitter_rows, fibres(2)), made(0.0, fibres(2))
    rows = np.full(524, 260.0) if standing else np.arange(524.0) + 0.7
    known = Disturbances(jittering.instrument, 3, laser=True, of_camera=True)
    for frame in (1, 2, 3, 4, 5, 6):
        expected = steady.core_values(frame, line_rows=rows + known.jitter_rows(frame))
        found = jittering.core_values(frame, line_rows=rows)
        np.testing.assert_allclose(found, expected, atol=0.004 * expected.max())


@pytest.fixture
def computed(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """An item for each time that the light of a view is computed."""
    times, light = [], LineScan.light
    monkeypatch.setattr(LineScan, "light", lambda *arguments: times.append(1) or light(*arguments))
    return times


def test_the_light_is_computed_once_for_each_step_of_the_jitter(computed: list[int]) -> None:
    jittering = made(0.05, uniform())
    for frame in range(30):
        jittering.core_values(frame)
    assert len(computed) <= 2 * (COMPUTED_FRAMES + 3)  # views; first frames, and steps on either side of none


def test_a_scan_of_one_frame_is_computed_for_its_jitter_alone(computed: list[int]) -> None:
    jittering = made(0.5, uniform())
    for frame in range(5):
        jittering.core_values(frame, line_rows=np.arange(524.0) + frame)
    assert len(computed) == 2 * 5
