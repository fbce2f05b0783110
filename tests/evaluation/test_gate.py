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
@pytest.mark.parametrize("jerks", [False, True], ids=["smooth", "jerky"])
def test_99_of_100_wrong_links_are_caught_and_95_right_ones_kept(jerks: bool) -> None:
    links = judged_links(40, 12, jerks=jerks)
    found = gate(links)
    assert found.wrong == 0 or found.caught_percent >= 99
    assert found.kept_percent >= 95
