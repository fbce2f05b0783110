"""The table of predictions counts what lies within 5 % and within the stated uncertainties."""

from __future__ import annotations

from typing import TYPE_CHECKING

from benchmarks.documents import recommendation
from benchmarks.studies.recommendation import Compared

if TYPE_CHECKING:
    from pathlib import Path

    import pytest


def test_errors_and_uncertainties_are_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = iter([Compared(101.0, 100.0, 2.0), Compared(106.0, 100.0, 4.0)])

    def compared(_: object) -> dict[str, Compared]:
        return dict.fromkeys(("drop_3db_um", "drop_10db_um", "signal_kept"), next(found))

    monkeypatch.setattr(recommendation, "compare_prediction", compared)
    page = tmp_path / "calibration.md"
    page.write_text("<!-- recommendation -->\n<!-- end -->\n")
    recommendation.make(tmp_path, quick=True)
    assert "| ELS+ 3 dB distance | 4.30% | 6.00% | 1 | 1 | 2 |" in page.read_text()
