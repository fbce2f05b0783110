"""Contact sheets: every image has a scale bar where its scale is known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from napari_elsplus.instrument.calibration import Calibration, OpticsSection
from napari_elsplus.processing.images.sectioning import Mode
from napari_elsplus.workflows.batch.tiles import read_tile, write_tile
from napari_elsplus.workflows.comparison import compare
from napari_elsplus.workflows.pictures.batch_sheet import draw_batch_sheet
from napari_elsplus.workflows.pictures.contact_sheet import draw_contact_sheet
from napari_elsplus.workflows.pictures.files import save_figure, save_grey_figure
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


def test_a_batch_sheet_has_the_name_and_scale_of_each_picture(tmp_path: Path) -> None:
    image = np.ones((700, 600), np.float32)
    image[:350] = 2
    scales = {name: write_tile(tmp_path / name, image, um_per_px) for name, um_per_px in (("a", 1.0), ("b", None))}
    assert scales == {"a": 3.0, "b": None}
    figure = draw_batch_sheet([(name, read_tile(tmp_path / name), um_per_px) for name, um_per_px in scales.items()])
    assert sorted(labels(figure)) == ["100 µm", "a", "b"]
    (bar,) = figure.axes[0].lines
    assert np.ptp(bar.get_xdata()) == pytest.approx(100 / 3)  # of pixels reduced threefold
    drawn = np.asarray(figure.axes[0].images[0].get_array())
    right, bottom = int(max(bar.get_xdata())), int(bar.get_ydata()[0])
    assert drawn[bottom, right] == drawn[bottom, right - 100] == 0  # on the picture of a, not beside it
    save_figure(figure, tmp_path / "colours.png")
    save_grey_figure(figure, tmp_path / "grey.png")
    colours = np.asarray(Image.open(tmp_path / "colours.png").convert("RGB"))
    np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "grey.png"))[..., None].repeat(3, axis=2), colours)


@pytest.mark.parametrize("shape", [(700, 3), (6, 700), (40, 50)])
def test_tiles_of_any_shape_show_nothing_where_nothing_was_seen(tmp_path: Path, shape: tuple[int, int]) -> None:
    image = np.full(shape, np.nan, np.float32)
    write_tile(tmp_path / "unseen", image, None)
    assert not read_tile(tmp_path / "unseen").any()
    image[: shape[0] // 2] = np.linspace(1, 9, shape[0] // 2)[:, None]
    write_tile(tmp_path / "half", image, None)
    half = read_tile(tmp_path / "half")
    assert half.max() > 100
    assert not half[-1].any()
