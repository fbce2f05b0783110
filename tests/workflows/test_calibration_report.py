"""The calibration report: every number of the calibration, and a page for each step that was measured."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import pytest
from matplotlib.text import Text

from napari_elsplus import simulate_calibration
from napari_elsplus.errors import InputError
from napari_elsplus.instrument.calibration import Calibration
from napari_elsplus.workflows.calibration import calibrate
from napari_elsplus.workflows.calibration_report.report import (
    calibration_numbers,
    draw_calibration_report,
    save_calibration_report,
)
from napari_elsplus.workflows.pictures.curves import PAPER_COLOURS

if TYPE_CHECKING:
    from pathlib import Path

    from napari_elsplus.processing.calibration.draft import Draft


@pytest.fixture(scope="module")
def draft() -> Draft:
    taken = simulate_calibration(seed=3)
    return calibrate(line=list(taken.line)[:4], bundle=list(taken.bundle)[:4], bundle_um=620.0)


def texts(figure) -> str:
    return "\n".join(text.get_text() for text in figure.findobj(Text))


def test_it_states_numbers_uncertainties_and_the_date(draft: Draft) -> None:
    first, offset, pair = (texts(page) for page in draw_calibration_report(draft))
    assert draft.calibration.created[:10] in first
    for _, name, value, _ in calibration_numbers(draft.calibration):
        assert name in first
        assert value in first
    assert "missing" in first
    found = draft.found["offset"]
    assert f"{found.rows:.3f} ± {found.uncertainty_rows:.3f} rows" in offset
    assert "confocal" in offset
    assert "alignment error" in pair


def test_it_states_the_timing_as_exactly_as_the_camera_does() -> None:
    """Before: 1090 line periods per frame of 1089.6."""
    known = Calibration.parse({"optics": {"line_period_s": 7.648e-6, "rows_per_frame": 1089.6, "um_per_px": 0.96083}})
    values = {number.quantity: number.value for number in calibration_numbers(known)}
    assert values == {"line period": "7.648", "line periods per frame": "1089.6", "scale": "0.96083"}


def test_each_of_its_colours_is_another() -> None:
    assert len(set(PAPER_COLOURS.values())) == len(PAPER_COLOURS)


def test_it_is_one_pdf_and_overwrites_nothing(draft: Draft, tmp_path: Path) -> None:
    path = tmp_path / "report.pdf"
    assert save_calibration_report(draft, path) == 3
    assert path.read_bytes().startswith(b"%PDF")
    assert [one.name for one in tmp_path.iterdir()] == ["report.pdf"]
    with pytest.raises(InputError, match="exists"):
        save_calibration_report(draft, path)
    with pytest.raises(InputError, match=r"suffix that cannot be written: let it end in \.pdf"):
        save_calibration_report(draft, tmp_path / "report.png")


def test_a_calibration_from_a_file_has_its_numbers_only(draft: Draft) -> None:
    (only,) = draw_calibration_report(replace(draft, found={}))
    assert "not measured in this session" in texts(only)
