"""The scripts in ``examples`` run as they stand and write what they promise."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.checkout

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
WRITTEN = {
    "calibrate_from_files": ("slit offset -21.7", ["rig.json", "rig.npz"]),
    "measure_the_sectioning": ("signal kept in contact: 82 %", []),
    "mosaic_of_a_recording": ("40 of 40 frames tracked", ["mosaic.ome.tif", "track.csv"]),
    "recommend_an_offset": ("to keep 95 %: slit 8 rows, offset -52.7 rows", []),
    "section_a_recording": ("els: 12 images", ["ls.ome.tif", "els.ome.tif", "comparison.png"]),
}
"""Of each script, a part of what it prints and the files it writes."""


def test_every_example_is_run() -> None:
    live = {"run_the_simulated_rig"}  # in test_live_example, as it judges lost frames
    assert {path.stem for path in EXAMPLES.glob("*.py")} == set(WRITTEN) | live


@pytest.mark.parametrize("name", WRITTEN)
def test_the_example_works(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [name])
    runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")
    printed, files = WRITTEN[name]
    assert printed in capsys.readouterr().out
    assert [file for file in files if not (tmp_path / file).is_file()] == []
