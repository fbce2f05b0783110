"""The list of deliberate mistakes stays true: each can still be made, and module and tests exist."""

from __future__ import annotations

import ast

import pytest

from benchmarks.harness.edits import PACKAGE, ROOT
from benchmarks.programs.mutations import MISTAKES, TESTS

pytestmark = pytest.mark.checkout


def test_there_are_sixty_mistakes_and_more() -> None:
    assert len({mistake.label for mistake in MISTAKES}) >= 60


@pytest.mark.parametrize("mistake", MISTAKES, ids=lambda mistake: mistake.label[:60])
def test_every_mistake_can_be_made_and_is_python(mistake, tmp_path) -> None:
    copy = tmp_path / PACKAGE / f"{mistake.module}.py"
    copy.parent.mkdir(parents=True)
    before = (ROOT / PACKAGE / f"{mistake.module}.py").read_text("utf-8")
    copy.write_text(before, "utf-8")
    mistake.apply(tmp_path)
    assert ast.dump(ast.parse(copy.read_text("utf-8"))) != ast.dump(ast.parse(before))
    assert all((ROOT / "tests" / "hardware" / test).is_file() for test in TESTS[mistake.module])
