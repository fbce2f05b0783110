from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np
import pytest

from benchmarks.documents import physics
from benchmarks.documents.physics_charts import kept_signal
from napari_elsplus.processing.axial import axial_response as axial
from napari_elsplus.simulation.model.axial_response import LINE_MODELS, model_response
from napari_elsplus.workflows.sectioning_performance import SectioningPerformance, predict_performance

if TYPE_CHECKING:
    from pathlib import Path

    from napari_elsplus.processing.axial.axial_response import AxialResponse
    from napari_elsplus.simulation.model.instrument import Instrument


def closed_form(instrument: Instrument, *, seed: int = 0, light: float = 1.0) -> AxialResponse:
    """What a scan without noise would give; each seed's plate a thousandth brighter, so that they differ."""
    depth_um = np.arange(0.0, 900.0, 2.0)
    slit_um = instrument.slit_rows * instrument.optics.um_per_px
    response = model_response(depth_um, offset_um=instrument.offset_um, slit_um=slit_um, line=instrument.line)
    bright = 80 * light
    return axial.axial_response(depth_um, (bright + seed / 1000) * response.ls, bright * response.residual)


def trade(offset_um: float) -> SectioningPerformance:
    return predict_performance(offset_um, 2.9, LINE_MODELS["a"], 80.0)


@pytest.fixture
def page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """The page as it is made of scans without noise."""
    monkeypatch.setattr(physics, "measure_axial", closed_form)
    monkeypatch.setattr(physics, "mean_residual", lambda _: np.full((645, 645), 50, np.float32))
    monkeypatch.setattr(physics, "weigh_offset", trade)
    (tmp_path / "images").mkdir()
    marks = "".join(f"<!-- {name} -->\n<!-- end -->\n" for name in physics.TABLES)
    (tmp_path / "physics.md").write_text(marks)
    physics.make(tmp_path)
    assert len(list((tmp_path / "images").glob("physics-*.png"))) == 6
    return (tmp_path / "physics.md").read_text()


def numbers(page: str, row: str) -> list[float]:
    (line,) = [line for line in page.splitlines() if line.startswith(f"| {row} |")]
    return [float(number) for number in re.findall(r"[-+]?\d+\.?\d*", line[len(row) + 2 :])]


def test_the_tables_hold_closed_form_and_measurement_against_the_paper(page: str) -> None:
    paper_3db, spread_3db, paper_10db, spread_10db, *_ = numbers(page, "LS")
    assert (paper_3db, spread_3db, paper_10db, spread_10db) == (58, 3, 550, 20)
    paper, closed, with_rim, measured = np.reshape(numbers(page, "ELS, offset 29")[:8], (4, 2))
    np.testing.assert_allclose(paper, (35.1, 118.9))
    np.testing.assert_allclose(with_rim, closed, rtol=0.02)
    np.testing.assert_allclose(measured, closed, rtol=0.01)
    off_percent = numbers(page, "ELS, offset 29")[8:]
    exact = closed_form(physics._instrument(29.0, 2.9, "a"))  # the table has one decimal of a micrometre
    np.testing.assert_allclose(
        off_percent, 100 * (np.array((exact.els_3db.um, exact.els_10db.um)) / paper - 1), atol=0.06
    )
    mean, *_, low, high = numbers(page, "ELS+ 10 dB (um)")
    assert low < mean < high
    assert (low, high) == (113.0, 124.8)
    assert numbers(page, "74") == [1, 1, 1]  # an even image is as bright at its rim as in its centre


def test_signal_kept_is_drawn_against_offset_and_against_slit_between_the_papers_bounds() -> None:
    by_slit = {slit: closed_form(physics._instrument(77.0, slit, "b")) for slit in (2.9, 8.8)}
    by_offset = {offset: closed_form(physics._instrument(offset)) for offset in (12.0, 77.0)}
    figure = kept_signal(by_offset, by_slit)
    against_offset, against_slit = figure.axes
    for axes in figure.axes:
        curve, points = axes.lines
        curve_y = np.interp(points.get_xdata(), curve.get_xdata(), curve.get_ydata())
        np.testing.assert_allclose(points.get_ydata(), curve_y, atol=1.5)
    assert min(against_slit.lines[0].get_ydata()) > 95  # "virtually no price paid" at 77 um
    assert against_offset.lines[0].get_ydata()[0] < 5  # a slit beside the line's middle samples light from the focus
