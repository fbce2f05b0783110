"""The axial response of a whole bundle against the closed form without a rim, and against the renderer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.rigs.clipped_response import MAX_DEPTH_UM, clipped_drop_offs, clipped_response
from napari_elsplus.simulation.model.axial_response import LINE_MODELS, model_drop_offs, model_response
from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.simulation.rendering.renderer import Renderer
from napari_elsplus.simulation.specimen.scenes import plate

DEPTHS_UM = np.array([0.0, 20, 60, 150, 400, 700])


def upright(offset_um: float, **changes: object) -> Instrument:
    return Instrument.of("120hz", slit_um=2.9, offset_um=offset_um, line_tilt_deg=0.0, **changes)


def test_line_scan_and_els_drop_offs_of_the_paper() -> None:
    ls, els = clipped_drop_offs(Instrument.of("120hz", slit_um=2.9, offset_um=29))
    assert ls == pytest.approx((58, 550), rel=0.01)
    assert els == pytest.approx((35.1, 118.9), rel=0.02)


def test_near_the_focus_a_rim_far_away_takes_nothing() -> None:
    line = replace(LINE_MODELS["b"], halo_share=0.0)
    instrument = upright(29.0, line=line)
    clipped = clipped_response(instrument, DEPTHS_UM[:4])
    closed = model_response(DEPTHS_UM[:4], offset_um=29.0, slit_um=instrument.slit_um, line=line)
    assert clipped.ls == pytest.approx(closed.ls, abs=2e-4)
    assert clipped.residual == pytest.approx(closed.residual, abs=2e-4)


def test_the_rim_takes_from_afar_more_from_ls_than_from_els() -> None:
    ls, els = clipped_drop_offs(upright(29.0))
    rimless_ls, rimless_els = model_drop_offs(offset_um=None), model_drop_offs(offset_um=29.0)
    assert 0.94 < ls.drop_10db_um / rimless_ls.drop_10db_um < 0.96
    assert els.drop_10db_um / rimless_els.drop_10db_um == pytest.approx(1, abs=0.002)


def test_it_is_what_the_cores_in_the_middle_receive() -> None:
    instrument = Instrument.of("120hz", slit_um=2.9, offset_um=-58, autofluorescence=0.0)
    cores = instrument.bundle.cores()
    middle = (np.abs(cores.rows_um) < 120) & (np.abs(cores.cols_um) < 120)

    def received(depth_um: float) -> np.ndarray:
        values = Renderer(instrument, plate(depth_um + instrument.line.gap_um), noise=False).core_values(0)
        return (values / cores.transmission)[:, middle].mean(1)

    contact = received(0.0)[0]
    for depth_um in (0.0, 60.0, 500.0):
        confocal, residual = received(depth_um)
        expected = clipped_response(instrument, depth_um)
        assert confocal / contact == pytest.approx(expected.ls, rel=2e-3)
        assert residual / instrument.residual_view.gain / contact == pytest.approx(expected.residual, rel=2e-3)


def test_a_distance_beyond_reach_is_not_invented() -> None:
    slow = replace(LINE_MODELS["a"], spread=0.1)
    ls, els = clipped_drop_offs(upright(29.0, line=slow))
    assert np.isnan(ls.drop_10db_um)
    assert els.drop_10db_um < MAX_DEPTH_UM
