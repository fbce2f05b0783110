from __future__ import annotations

from benchmarks.studies.mosaicing import TRANSLATION, Scenario, outcomes


def test_methods_are_held_against_the_scene_that_was_there() -> None:
    made = outcomes(Scenario("fibres", "straight", 8000.0, 6))
    ours, translation, paper = made["elsplus"], made[TRANSLATION], made["paper"]
    assert ours.correlation > 0.98 > ours.focal_correlation > 0.95
    assert 0.9 > translation.correlation > paper.correlation - 0.1
    assert ours.errors.median_pair_error_px < 0.1 < translation.errors.median_pair_error_px
    assert ours.error_px.shape == (6,)
    assert ours.error_px[0] == 0
    assert ours.mosaic.shape == ours.truth.shape
