"""Models of the map between the views: each contains the one before, and none more than it says."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from napari_elsplus.processing.calibration.bundle.view_maps import ViewModel, affine_map, nearest_affine
from napari_elsplus.processing.images.distortion import POWERS, polynomial_terms

RADIUS_PX = 95.0


def spanned(model: ViewModel) -> np.ndarray:
    return model.basis.reshape(len(model.basis), -1)


@pytest.mark.parametrize(("simpler", "model"), list(pairwise(ViewModel)))
def test_a_model_contains_the_one_before_it(simpler: ViewModel, model: ViewModel) -> None:
    ranks = [np.linalg.matrix_rank(np.vstack(rows)) for rows in ([spanned(model)], [spanned(model), spanned(simpler)])]
    assert ranks == [len(model.basis)] * 2
    assert len(simpler.basis) < len(model.basis)


def test_a_similarity_is_a_rotation_and_a_scale() -> None:
    turn, scale = 0.02, 1.01
    motion = scale * np.array([[np.cos(turn), -np.sin(turn), 0.0], [np.sin(turn), np.cos(turn), 0.0]])
    departure = (affine_map(motion, RADIUS_PX) - affine_map(np.eye(2, 3), RADIUS_PX)).ravel()
    along = spanned(ViewModel.SIMILARITY).T
    np.testing.assert_allclose(along @ np.linalg.lstsq(along, departure)[0], departure, atol=1e-9)


def test_a_radial_distortion_about_any_centre_is_spanned_up_to_its_second_order() -> None:
    rows, cols = np.random.default_rng(0).uniform(-0.7, 0.7, (2, 200))
    offset = np.array([0.01, -0.02])
    away = np.stack([rows, cols]) - offset[:, None]
    displaced = (away * np.square(away).sum(axis=0)).T.ravel()
    terms = polynomial_terms(rows, cols)
    design = np.moveaxis(ViewModel.RADIAL.basis @ terms, 0, -1).transpose(1, 0, 2).reshape(len(displaced), -1)
    left = displaced - design @ np.linalg.lstsq(design, displaced)[0]
    assert np.abs(left).max() < 1e-2 * np.abs(offset).max()


def test_the_affine_part_of_an_affine_map_is_that_map() -> None:
    motion = np.array([[1.01, 0.002, 3.0], [-0.003, 0.99, -5.0]])
    terms = polynomial_terms(*np.random.default_rng(1).uniform(-0.9, 0.9, (2, 300)))
    coefficients = affine_map(motion, RADIUS_PX)
    assert coefficients.shape == (2, len(POWERS))
    np.testing.assert_allclose(nearest_affine(coefficients, terms, RADIUS_PX), motion, rtol=1e-12)
