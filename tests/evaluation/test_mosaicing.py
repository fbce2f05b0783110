from __future__ import annotations

import numpy as np

from napari_elsplus.evaluation.mosaicing import TRANSLATION, Scenario, judged_links, outcomes


def test_methods_are_held_against_the_scene_that_was_there() -> None:
    made = outcomes(Scenario("fibres", "straight", 8000.0, 6))
    ours, translation, paper = made["elsplus"], made[TRANSLATION], made["paper"]
    assert ours.correlation > 0.95 > 0.9 > translation.correlation > paper.correlation - 0.1
    assert ours.errors.median_pair_error_px < 0.1 < translation.errors.median_pair_error_px
    assert ours.error_px.shape == (6,)
    assert ours.error_px[0] == 0
    assert ours.mosaic.shape == ours.truth.shape


def test_links_of_sparse_scenes_that_are_wrong_have_no_evidence() -> None:
    links = judged_links(3000.0, 10, 2)
    assert len(links) == 18
    evidence, _, error = np.array(links).T
    assert (error[evidence >= 0.1] < 1).all()
    assert (evidence >= 0.1).sum() > 9
