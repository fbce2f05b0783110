"""The history of calibrations: numbers over days, and warnings of drift and jumps that scatter does not explain."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING

import numpy as np
import pytest
from matplotlib.text import Text

from napari_elsplus.errors import InputError
from napari_elsplus.instrument.calibration import AcquiredWith, Calibration, OffsetSection
from napari_elsplus.io import write_calibration
from napari_elsplus.processing.calibration.draft import Draft
from napari_elsplus.workflows.calibration_report.history import CalibrationHistory, Trend, calibration_history
from napari_elsplus.workflows.calibration_report.report import draw_calibration_report
from pairs import calibration

if TYPE_CHECKING:
    from pathlib import Path

START = datetime(2026, 3, 1, 9, tzinfo=UTC)


def measured(rows: float, day: int, rig: str = "bench") -> Calibration:
    offset = OffsetSection(rows=rows, uncertainty_rows=0.02)
    created = (START + timedelta(days=day)).isoformat().replace("+00:00", "Z")
    update = {"offset": offset, "created": created, "acquired_with": AcquiredWith(rig=rig)}
    return calibration().model_copy(update=update)


def write(folder: Path, offsets: list[float]) -> Path:
    for day, rows in enumerate(offsets):
        write_calibration(folder / f"day-{9 - day}.json", measured(rows, day))
    return folder


def offset(history: CalibrationHistory) -> Trend:
    return next(trend for trend in history.trends if trend.name == "slit offset")


def test_numbers_are_ordered_by_day_with_their_uncertainty_and_other_rigs_left_out(tmp_path: Path) -> None:
    write(tmp_path, [-12.01, -12.03, -12.0])
    write_calibration(tmp_path / "other.json", measured(-30.0, 1, "another bench"))
    write_calibration(tmp_path / "copy.json", measured(-12.03, 1))
    (tmp_path / "broken.json").write_text('{"format": "napari-elsplus/calibration", "version": 1, "offset": 3}')
    (tmp_path / "foreign.json").write_text("{}")
    history = calibration_history(tmp_path)
    assert len(history.files) == 3
    found = offset(history)
    np.testing.assert_allclose(found.days, [-2, -1, 0])
    assert found.values.tolist() == [-12.01, -12.03, -12.0]
    assert found.sigmas.tolist() == [0.02] * 3
    in_um = next(trend for trend in history.trends if trend.name == "slit offset in micrometres")
    np.testing.assert_allclose(in_um.values, 2 * found.values)
    assert history.warnings == []


def test_a_jump_and_a_drift_are_reported_with_their_size(tmp_path: Path) -> None:
    jumped = calibration_history(write(tmp_path, [-12.01, -12.03, -12.0, -12.02, -12.01, -13.0]))
    assert offset(jumped).warning.startswith("slit offset: the newest differs by -0.986 rows from the 5 before")
    assert any("slit offset" in warning for warning in jumped.warnings)
    days = np.arange(-9.0, 1)
    slow = replace(offset(jumped), days=days, values=0.05 * days, sigmas=np.full(10, 0.02))
    assert slow.warning == "slit offset drifts by +0.05 rows a day"


@pytest.mark.parametrize("count", [4, 10, 40])
def test_scatter_alone_is_seldom_reported(count: int) -> None:
    rng = np.random.default_rng(count)
    days, trials = np.arange(1.0 - count, 1), 400
    trends = (Trend("x", "rows", days, rng.normal(0, 0.1, count), np.zeros(count)) for _ in range(trials))
    assert sum(bool(trend.warning) for trend in trends) <= 5


def test_an_empty_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="has no calibration"):
        calibration_history(tmp_path)


def test_the_report_has_a_page_of_the_history_with_its_warnings(tmp_path: Path) -> None:
    history = calibration_history(write(tmp_path, [-12.01, -12.03, -12.0, -12.02, -12.01, -13.0]))
    *_, last = draw_calibration_report(Draft(measured(-13.0, 5)), history)
    texts = [text.get_text() for text in last.findobj(Text)]
    assert any("6 calibrations of this rig" in text and "differs by -0.986 rows" in text for text in texts)
    assert "slit offset / rows" in texts
    (only,) = draw_calibration_report(Draft(measured(-13.0, 5)), CalibrationHistory(history.files[-1:], ()))
    assert only is not last
