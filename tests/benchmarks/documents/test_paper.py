from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from benchmarks.documents.paper import alignment_table, calibration_table, draw_calibration, draw_images, mosaic_table
from benchmarks.studies import paper
from napari_elsplus.simulation.accuracy import TrackErrors
from napari_elsplus.simulation.model.instrument import Instrument

if TYPE_CHECKING:
    from pathlib import Path


def cells(table: str, row: str) -> list[str]:
    (line,) = [line for line in table.splitlines() if line.startswith(f"| {row} |")]
    return [cell.strip() for cell in line.strip("|").split("|")]


def test_a_calibration_is_told_with_its_uncertainty_and_its_error(tmp_path: Path) -> None:
    instrument = Instrument.of("240hz")
    found = paper.calibrate_simulated(instrument, steps=20)
    table = calibration_table(found)
    _, offset, error = cells(table, "slit offset / rows")
    rows, _, uncertainty_rows = offset.split()
    assert abs(float(rows) - float(error) - instrument.offset_rows) < 0.001
    assert 0 < float(uncertainty_rows) < 0.05
    assert cells(table, "alignment error")[2] == "(the paper: 5.5 %)"
    median = cells(table, "the same, after the 3x3 median filter")
    assert median[2] == "(the paper: 0.74 %)"
    assert 0 < float(median[1].split()[0]) < float(cells(table, "alignment error")[1].split()[0])
    assert next(iter(found.pictures)) == paper.LINE
    first, by_cores, *by_centres = alignment_table(found).splitlines()[2:]
    assert "5.5 %" in first
    assert "0.74 %" in first
    unfiltered = [float(line.split("|")[2].split()[0]) for line in (by_cores, *by_centres)]
    assert len(unfiltered) == 3
    assert unfiltered[0] < min(unfiltered[1:])
    draw_calibration(found).savefig(tmp_path / "calibration.png")


def test_mosaics_are_drawn_and_told(tmp_path: Path) -> None:
    image = np.tile(np.float32([10, 100]), (60, 40))
    made = {"ELS+": paper.Mosaicked(image, TrackErrors(10, 9, 2, 0.0123, 1, 0.0456, 100.0), 2)}
    assert cells(mosaic_table(made), "ELS+") == ["ELS+", "9/10", "2", "0.012", "0.046", "1", "0.10"]
    figure = draw_images({"one": image, "two": image.T, "three": image}, 3)
    assert [axes.get_title() for axes in figure.axes] == ["one", "two", "three"]
    figure.savefig(tmp_path / "images.png")
