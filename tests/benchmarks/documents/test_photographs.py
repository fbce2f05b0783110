"""Photographs are drawn by each way to show one frame; a peer that is not installed is left out."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
import tifffile

from benchmarks.documents import photographs
from benchmarks.harness.methods import Absent
from benchmarks.rigs.photographs import PHOTOGRAPHS
from benchmarks.rigs.simulated import measured
from napari_elsplus.errors import InputError
from napari_elsplus.simulation.model.bundle import Bundle
from napari_elsplus.simulation.model.instrument import Instrument

if TYPE_CHECKING:
    from pathlib import Path


def test_each_target_is_a_row_and_each_way_a_column(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def absent(name: str) -> None:
        raise Absent(f"{name} is not installed", "install it")

    monkeypatch.setattr(photographs, "peer", absent)
    flat = measured(replace(Instrument.of("240hz"), bundle=Bundle(diameter_um=160.0))).calibration.flat
    assert flat is not None
    even = np.pad(60 * flat, 12).astype(np.uint8)
    half = even * np.where(np.arange(len(even)) < len(even) // 2, 1.0, 0.5)
    for name, flat_name in PHOTOGRAPHS.items():
        tifffile.imwrite(tmp_path / f"{name}.tif", half.astype(np.uint8))
        if flat_name is not None:
            tifffile.imwrite(tmp_path / f"{flat_name}.tif", even)
    figure = photographs.draw_photographs(tmp_path)
    ways = ("as taken", "median 3x3", "interpolated between cores", "core by core")
    titles = [axes.get_title() for axes in figure.axes]
    assert titles == [f"{name}: {way}" for name, flat_name in PHOTOGRAPHS.items() if flat_name for way in ways]
    part = figure.axes[len(ways) - 1].images[0].get_array()
    left, right = (float(np.median(half)) for half in np.array_split(np.asarray(part), 2, axis=1))
    assert right / left == pytest.approx(0.5, abs=0.05)


def test_a_folder_without_photographs_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"has no tissue_paper\.tif"):
        photographs.draw_photographs(tmp_path)
