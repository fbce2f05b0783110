from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from napari_elsplus.io import read_calibration, read_track
from napari_elsplus.workflows.demo import FILES


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("demo")


def test_the_demonstration_does_the_whole_job(elsplus: Callable[..., Any], folder: Path) -> None:
    run = elsplus("demo", "--out", folder)
    assert run.code == 0, run.err
    assert {path.name for path in folder.iterdir()} == set(FILES)
    report = json.loads((folder / "report.json").read_text())
    errors = report["calibration_errors"]
    assert abs(errors["offset_rows"]) < 0.05
    assert abs(errors["galvo_slope_percent"]) < 0.1
    assert errors["pair_alignment_px"] < 0.2
    assert report["correlation_with_focal_plane"]["els"] > report["correlation_with_focal_plane"]["ls"]
    track = report["tracking"]["els"]
    assert track["tracked"] == track["frames"]
    assert track["wrong_links"] == 0
    assert track["median_pair_error_px"] < 0.1
    assert len(read_track(folder / "track.csv")) == track["frames"]
    read_calibration(folder / "calibration.json").require("offset", "galvo", "bundle", "optics", "quality")
    assert "contact_sheet.png" in run.out


def test_results_are_not_overwritten_unasked(elsplus: Callable[..., Any], tmp_path: Path) -> None:
    (tmp_path / "track.csv").write_text("precious")
    run = elsplus("demo", "--out", tmp_path)
    assert run.code == 2
    assert "--force" in run.err
    assert [path.name for path in tmp_path.iterdir()] == ["track.csv"]
