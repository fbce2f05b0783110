from __future__ import annotations

import pytest

from napari_elsplus.evaluation.gate import gate, judged_links


@pytest.mark.parametrize("jerks", [False, True], ids=["smooth", "jerky"])
def test_links_of_sparse_scenes_that_are_wrong_are_refused(jerks: bool) -> None:
    found = gate(judged_links(10, 2, jerks=jerks))
    assert found.right > 15
    assert found.kept_percent > 80
    assert found.wrong == 0 or found.caught_percent == 100


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fibres", "jerks", "kept"), [(180, False, 95), (180, True, 80), (60, False, 75), (60, True, 60)]
)
def test_wrong_links_are_caught_where_little_is_in_view(fibres: int, jerks: bool, kept: float) -> None:
    """Fewer right ones are kept the less is in view: many of these are right only because they started near."""
    found = gate(judged_links(40, 6, fibres, jerks=jerks))
    assert found.wrong == 0 or found.caught_percent > 95
    assert found.kept_percent > kept
