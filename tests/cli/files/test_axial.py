"""``simulate axial`` then ``axial``: sectioning measured through raw frames, against the paper."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import tifffile

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    Elsplus = Callable[..., Any]


def measured(elsplus: Elsplus, folder: Path, *options: object) -> dict[str, Any]:
    scan, out = folder / "scan.ome.tif", folder / "out.json"
    assert elsplus("simulate", "axial", *options, "-o", scan).code == 0
    run = elsplus("axial", scan, "-o", out, "--plot", folder / "out.png")
    assert run.code == 0, run.err
    assert f"calibration: {folder / 'scan.calibration.json'}" in run.out
    assert "signal kept" in run.out
    assert " +- 0.0 um" not in run.out
    assert (folder / "out.png").read_bytes()[:4] == b"\x89PNG"
    content: dict[str, Any] = json.loads(out.read_text())
    return content


def test_drop_offs_of_the_paper_through_raw_frames(elsplus: Elsplus, tmp_path: Path) -> None:
    """Seed 0, one frame per depth, depths 2 um apart to 120 um, 5 um to 300 um, 10 um to 700 um."""
    found = measured(elsplus, tmp_path, "--slit-um", 2.9, "--offset-um", 29)
    assert found["ls"]["drop_3db_um"] == pytest.approx(58, abs=3)
    assert found["ls"]["drop_10db_um"] == pytest.approx(550, abs=20)
    assert found["els"]["drop_3db_um"] == pytest.approx(35.1, rel=0.05)
    assert found["els"]["drop_10db_um"] == pytest.approx(118.9, rel=0.05)
    assert found["signal_kept"] == pytest.approx(0.82, abs=0.01)
    curves = found["profiles"]
    assert len(found["depth_um"]) == len(curves["ls"]) == len(curves["residual"]) == len(curves["els"])
    assert np.subtract(curves["ls"], curves["residual"]) == pytest.approx(
        found["signal_kept"] * np.array(curves["els"]), abs=1e-6
    )


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(10))
def test_ten_seeds_keep_their_margin(elsplus: Elsplus, tmp_path: Path, seed: int) -> None:
    found = measured(elsplus, tmp_path, "--slit-um", 2.9, "--offset-um", 29, "--seed", seed)
    assert found["ls"]["drop_3db_um"] == pytest.approx(58, abs=1)
    assert found["ls"]["drop_10db_um"] == pytest.approx(550, abs=5)
    assert found["els"]["drop_3db_um"] == pytest.approx(35.1, rel=0.02)
    assert found["els"]["drop_10db_um"] == pytest.approx(118.9, rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("offset_um", "drop_3db_um", "drop_10db_um"), [(12, 18.5, 52.7), (40, 41.9, 157), (58, 48.9, 212), (77, 53.1, 262)]
)
def test_other_offsets_of_the_paper(
    elsplus: Elsplus, tmp_path: Path, offset_um: float, drop_3db_um: float, drop_10db_um: float
) -> None:
    found = measured(elsplus, tmp_path, "--slit-um", 2.9, "--offset-um", offset_um)
    assert found["els"]["drop_3db_um"] == pytest.approx(drop_3db_um, rel=0.15)
    assert found["els"]["drop_10db_um"] == pytest.approx(drop_10db_um, rel=0.15)
    if offset_um == 77:
        assert found["signal_kept"] > 0.95


@pytest.mark.slow
@pytest.mark.parametrize("slit_um", [1.9, 2.9, 5.8])
def test_slit_width_hardly_matters_for_els(elsplus: Elsplus, tmp_path: Path, slit_um: float) -> None:
    found = measured(elsplus, tmp_path, "--slit-um", slit_um, "--offset-um", 29)
    assert found["els"]["drop_10db_um"] == pytest.approx(120, rel=0.05)


@pytest.fixture
def folder(elsplus: Elsplus, tmp_path: Path) -> Path:
    """A recording that is no scan of depths, and depths for it."""
    elsplus(
        "simulate", "recording", "--scene", "uniform", "--path", "still", "--frames", 4, "-o", tmp_path / "r.ome.tif"
    )
    return tmp_path


def test_what_is_missing_is_named(elsplus: Elsplus, folder: Path) -> None:
    def line(*arguments: object) -> str:
        run = elsplus("axial", *arguments, "-o", folder / "out.json")
        assert run.code == 2
        assert len(run.err.strip().splitlines()) == 1
        assert not (folder / "out.json").exists()
        return str(run.err)

    assert "no r.depths.csv beside the scan" in line(folder / "r.ome.tif")
    assert "p.docx has a suffix that cannot be written" in line(folder / "r.ome.tif", "--plot", folder / "p.docx")
    assert "out.json is named twice" in line(folder / "r.ome.tif", "--plot", folder / "out.json")
    depths = folder / "d.csv"
    depths.write_text("depth_um\n0\n10\n20\n")
    assert "3 depths for 4 frames" in line(folder / "r.ome.tif", "--depths", depths)
    bare = folder / "bare"
    bare.mkdir()
    tifffile.imwrite(bare / "scan.tif", np.zeros((5, 64, 64), np.uint8))
    assert "no calibration in or beside scan.tif" in line(bare / "scan.tif", "--depths", depths)


def test_a_folder_of_frames_is_a_scan_from_within(
    elsplus: Elsplus, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The folder that one is in has a name too, by which its depths are found."""
    frames = folder / "frames"
    frames.mkdir()
    for number, image in enumerate(tifffile.imread(folder / "r.ome.tif")):
        tifffile.imwrite(frames / f"{number}.tif", image)
    monkeypatch.chdir(frames)
    run = elsplus("axial", ".", "-c", folder / "r.calibration.json", "-o", folder / "out.json")
    assert run.code == 2
    assert "no frames.depths.csv beside the scan" in run.err
