from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.text import Text

from napari_elsplus.errors import InputError
from napari_elsplus.instrument.calibration import Calibration
from napari_elsplus.processing.images.sectioning import Mode
from napari_elsplus.simulation.model.imperfections import Imperfections
from napari_elsplus.workflows.comparison import compare
from napari_elsplus.workflows.pictures.comparison import draw_comparison, scaled_images
from napari_elsplus.workflows.pictures.files import save_figure
from napari_elsplus.workflows.sectioning import section
from napari_elsplus.workflows.simulated import simulate_recording

SHAPE = (60, 130)
CALIBRATION = Calibration.parse(
    {
        "bundle": {
            "confocal_centre": [30.0, 32.0],
            "residual_centre": [28.0, 96.0],
            "diameter_px": 50,
            "residual_to_confocal": [[1, 0, 2], [0, 1, -64]],
        }
    }
)
RAW = np.random.default_rng(0).integers(0, 200, (3, *SHAPE)).astype(np.uint8)


def test_ls_and_els_reach_white_and_elsa_shares_the_factor_of_els() -> None:
    comparison = compare(RAW, CALIBRATION, 1)
    for mode in (Mode.LS, Mode.ELS):
        assert np.quantile(comparison.images[mode][comparison.inside], 1 - 1e-4) == pytest.approx(1)
    same_next = compare(np.stack([RAW[1], RAW[1]]), CALIBRATION)
    assert np.array_equal(same_next.images[Mode.ELSA], same_next.images[Mode.ELS])


def test_the_compared_images_are_those_that_section_makes() -> None:
    """Before: row noise was left in what `compare` showed, and taken out by `section` and in the Compare panel."""
    raw = simulate_recording(frames=2, imperfections=Imperfections(row_noise_dn=3.0))
    compared = compare(raw, raw.calibration)
    images = {mode: section(raw, raw.calibration, mode)[0] for mode in compared.images}
    for mode, image in scaled_images(images, compared.inside).items():
        np.testing.assert_array_equal(compared.images[mode], image)


def test_a_view_that_the_frame_cuts_is_compared_where_it_was_seen() -> None:
    """Before: ELSA and ELS+ were NaN as a whole, and drawn as white paper."""
    comparison = compare(RAW[:, :, :110], CALIBRATION)
    els = comparison.images[Mode.ELS]
    assert np.isnan(els[comparison.inside]).any()
    assert np.nanquantile(els[comparison.inside], 1 - 1e-4) == pytest.approx(1)
    assert np.isfinite(comparison.contrast(Mode.ELSA).background)
    drawn = [axes.get_images()[0].get_array() for axes in draw_comparison(comparison).axes if axes.get_images()]
    assert not any(np.isnan(image).any() for image in drawn)


@pytest.mark.parametrize(("frame", "count"), [(2, 3), (-1, 3), (0, 1)])
def test_elsa_needs_the_next_frame(frame: int, count: int) -> None:
    with pytest.raises(InputError, match=f"frame {frame} and the one after it are needed"):
        compare(RAW[:count], CALIBRATION, frame)


def test_the_figure_shows_each_image_on_the_same_scale(tmp_path: Path) -> None:
    figure = draw_comparison(replace(compare(RAW, CALIBRATION), um_per_px=2.0))
    images = [axes.get_images()[0] for axes in figure.axes if axes.get_images()]
    assert [image.get_clim() for image in images] == [(0, 1)] * 3
    assert [axes.texts[0].get_text() for axes in figure.axes[:3]] == ["20 \N{MICRO SIGN}m"] * 3  # of a disc of 100
    save_figure(figure, tmp_path / "c.png")
    assert (tmp_path / "c.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(InputError, match="exists"):
        save_figure(figure, tmp_path / "c.png")


def test_an_unknown_picture_format_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"c\.xyz"):
        save_figure(draw_comparison(compare(RAW, CALIBRATION)), tmp_path / "c.xyz")
    assert not list(tmp_path.iterdir())


def test_the_figure_is_legible_in_one_column() -> None:
    figure = draw_comparison(replace(compare(RAW, CALIBRATION), um_per_px=2.0))
    assert figure.get_figwidth() * 25.4 == pytest.approx(85)
    figure.draw_without_rendering()
    texts = [text for text in figure.findobj(Text) if text.get_text() and text.get_visible()]
    assert len(texts) > 10
    assert min(text.get_fontsize() for text in texts) >= 6
    page = figure.bbox
    for text in texts:
        box = text.get_window_extent()
        assert box.x0 >= page.x0 - 1
        assert box.x1 <= page.x1 + 1, text.get_text()


def test_profiles_follow_the_line_and_its_width() -> None:
    middle = compare(RAW, CALIBRATION)
    drawn = replace(middle, line=((10.0, 12.0), (40.0, 30.0)), line_width_px=1)
    assert len(drawn.profiles().position) == 36
    assert middle.profiles().unit == "px"
    (row, col), (row_end, col_end) = middle.ends
    assert row == row_end == (len(middle.inside) - 1) / 2
    assert col_end - col == pytest.approx(0.9 * 50, abs=0.5)
