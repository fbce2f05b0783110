"""Ablation: every change can be made, and leaving the threshold out lets registrations pass."""

from __future__ import annotations

import ast
import shutil

import pytest

from benchmarks.documents.ablation import ablation_table, draw_ablation
from benchmarks.harness.edits import PACKAGE, ROOT
from benchmarks.studies.ablation import KINDS, Change, Outcome, ablate, changes, simulated

pytestmark = pytest.mark.checkout


@pytest.mark.parametrize("change", changes()[1:], ids=lambda change: f"{change.rule}: {change.change}")
def test_every_change_can_be_made_and_is_python(change: Change, tmp_path) -> None:
    for module in {edit.module for edit in change.edits}:
        copy = tmp_path / PACKAGE / f"{module}.py"
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / PACKAGE / f"{module}.py", copy)
    for edit in change.edits:
        copy = tmp_path / PACKAGE / f"{edit.module}.py"
        before = copy.read_text("utf-8")
        edit.apply(tmp_path)
        assert ast.dump(ast.parse(copy.read_text("utf-8"))) != ast.dump(ast.parse(before))


def test_dust_stands_still() -> None:
    clean, dusty = simulated(KINDS[-1]._replace(dusty=False), 1), simulated(KINDS[-1], 1)
    dust = dusty.images - clean.images
    assert abs(dust - dust[0]).max() < 1e-2 * dust.std()
    assert 0.3 < dust.std() / clean.images.std() < 1


@pytest.mark.slow
def test_a_lower_threshold_accepts_more() -> None:
    unchanged, threshold = changes()[:2]
    (_, (before,)), (_, (after,)) = ablate([unchanged, threshold], [0], [KINDS[2]])
    assert threshold.change == "x 0.5"
    assert after.accepted > before.accepted > 0


def test_table_and_chart_show_every_change() -> None:
    found = [(change, [Outcome(k % 3, 10, 90.0, 0.1)] * 2) for k, change in enumerate(changes()[:4])]
    lines = ablation_table(found).splitlines()
    assert len(lines) == 6
    assert lines[3].count("1; 90.0 %; 0.100 %") == 2
    labels = [text.get_text() for text in draw_ablation(found).axes[0].get_yticklabels()]
    assert labels == list(dict.fromkeys(change.rule for change, _ in found[1:]))
