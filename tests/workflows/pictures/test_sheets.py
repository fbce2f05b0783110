"""Contact sheets: every image has a scale bar where its scale is known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from napari_elsplus.instrument.calibration import Calibration, OpticsSection
from napari_elsplus.io import write_mosaic
from napari_elsplus.processing.images.sectioning import Mode
from napari_elsplus.workflows.pictures.batch_sheet import draw_batch_sheet
from napari_elsplus.workflows.pictures.comparison import compare
from napari_elsplus.workflows.pictures.contact_sheet import draw_contact_sheet
from pairs import calibration, frames


def labels(figure):
    return [text.get_text() for axes in figure.findobj(lambda one: hasattr(one, "imshow")) for text in axes.texts]


@pytest.mark.parametrize("um_per_px", [2.0, None])
def test_every_image_of_the_contact_sheet_has_a_scale_bar_where_the_scale_is_known(um_per_px: float | None) -> None:
    known: Calibration = calibration().model_copy(update={"optics": OpticsSection(um_per_px=um_per_px)})
    raw = frames()
    mosaics = {mode: np.ones((100, 200), np.float32) for mode in (Mode.LS, Mode.ELS)}
    comparison = replace(compare(raw, known), um_per_px=um_per_px)
    figure = draw_contact_sheet(raw[0], known, comparison, mosaics, None if um_per_px is None else 10 * um_per_px)
    expected = ["50 µm"] + ["20 µm"] * 3 + ["1 mm"] * 2 if um_per_px else []
    assert sorted(labels(figure)) == sorted(expected)


def test_a_batch_sheet_has_the_scale_of_each_file(tmp_path: Path) -> None:
    image = np.ones((700, 600), np.float32)
    write_mosaic(tmp_path / "a.ome.tif", image, 1.0)
    write_mosaic(tmp_path / "b.ome.tif", image, None)
    figure = draw_batch_sheet([(name, tmp_path / f"{name}.ome.tif") for name in "ab"])
    assert labels(figure) == ["100 µm"]
    bar, axes = figure.axes[0].lines[0], figure.axes[0]
    assert np.ptp(bar.get_xdata()) == pytest.approx(100 / 3)  # of pixels reduced threefold
    assert axes.get_xlim() == (-0.5, 199.5)
