from __future__ import annotations

import numpy as np
import pytest

from napari_elsplus.errors import MeasurementError
from napari_elsplus.processing.analysis.image_quality import alignment_error, contrast, edge_artefact, white_level
from napari_elsplus.processing.images.sectioning import disc


def test_one_pixel_in_ten_thousand_saturates() -> None:
    image = np.random.default_rng(0).normal(100, 20, (400, 400))
    inside = np.ones(image.shape, bool)
    assert (image > white_level(image[inside])).sum() == 16


def test_white_level_of_darkness_can_be_divided_by() -> None:
    assert white_level(np.zeros((8, 8))) > 0


def test_alignment_error_is_the_paper_s() -> None:
    confocal = np.full((50, 50), 100.0)
    checks = np.where(np.indices((50, 50)).sum(0) % 2, 5.5, -5.5)
    assert alignment_error(confocal, confocal + checks, 50) == pytest.approx(0.055)
    assert np.isnan(alignment_error(np.zeros((50, 50)), checks, 50))


def test_alignment_error_ignores_the_rim() -> None:
    confocal = np.full((50, 50), 100.0)
    residual = np.where(disc(50, 46), confocal, 0)
    assert alignment_error(confocal, residual, 50) == 0


def test_contrast_falls_with_a_pedestal() -> None:
    image = np.random.default_rng(0).uniform(0, 100, (100, 100))
    inside = np.ones(image.shape, bool)
    assert contrast(image, inside).michelson == pytest.approx(0.8, abs=0.02)
    assert contrast(image + 100, inside).michelson == pytest.approx(0.8 / 3, abs=0.02)
    assert contrast(image - 20, inside).michelson == 1


def test_edge_artefact_is_the_mean_over_its_middle() -> None:
    shading = np.linspace(0, 2, 301) + np.zeros((301, 1))
    noisy = (shading * level for level in (10.0, 30.0))
    assert edge_artefact(noisy) == pytest.approx(shading, abs=0.01)
    with pytest.raises(MeasurementError, match="0 residual images"):
        edge_artefact([])
    with pytest.raises(MeasurementError, match="dark"):
        edge_artefact([np.zeros((150, 150))])


def test_pixels_that_were_not_seen_count_neither_for_white_nor_for_contrast() -> None:
    """Before: NaN, by which images of a view that the frame cuts were displayed between 0 and 1, all white."""
    image = np.random.default_rng(0).uniform(0, 100, (100, 100))
    cut = np.where(np.arange(100) < 20, np.nan, image)
    inside = np.ones(image.shape, bool)
    assert white_level(cut) == white_level(image[:, 20:])
    assert contrast(cut, inside) == contrast(image[:, 20:], inside[:, 20:])
