"""The script in ``examples`` that streams from a rig loses no frame of the simulated one."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.checkout

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "run_the_simulated_rig.py"


def test_the_example_loses_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [EXAMPLE.stem])
    runpy.run_path(str(EXAMPLE), run_name="__main__")
    assert "lost: {}" in capsys.readouterr().out
    assert {path.name for path in tmp_path.iterdir()} >= {"live.ome.tif", "live.calibration.json"}
