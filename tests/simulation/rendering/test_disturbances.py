"""Imperfections in rendered frames, each judged by what it does to grey levels."""

from __future__ import annotations

import numpy as np
import pytest

from napari_elsplus.simulation.model.imperfections import Imperfections
from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.simulation.rendering.renderer import Renderer
from napari_elsplus.simulation.specimen.scenes import empty


def renderer(text: str, scene=None, **fields) -> Renderer:
    instrument = Instrument.of("240hz", imperfections=Imperfections.parse(text), **fields)
    return Renderer(instrument, scene or empty(), seed=5)


def test_row_noise_shifts_whole_rows_and_differs_from_frame_to_frame() -> None:
    ideal, noisy = renderer("", black_dn=20.0), renderer("row-noise=2", black_dn=20.0)
    first, second = (
        noisy.render(k).astype(float)[:, 1210:].mean(1) - ideal.render(k).astype(float)[:, 1210:].mean(1)
        for k in range(2)
    )
    assert first.std() == pytest.approx(2, rel=0.15)
    assert abs(np.corrcoef(first, second)[0, 1]) < 0.2
    again = renderer("row-noise=2", black_dn=20.0).render(1)
    assert (again == noisy.render(1)).all()
