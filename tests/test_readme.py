"""The README's words alone lead through a first visit: its commands are run here, in its order."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from napari_elsplus.cli import main

pytestmark = pytest.mark.checkout

PROJECT = Path(__file__).resolve().parents[1]
README = (PROJECT / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```sh\n(.*?)```", README, re.DOTALL)
LINES = [line.strip() for block in BLOCKS for line in block.splitlines() if line.strip()]
ELSEWHERE = "napari-elsplus demo --out demo"
"""Takes longest, and is run by the tests of ``demo``."""
OTHERS = {
    "source .venv/bin/activate",
    "mkdir visit",
    "cd visit",
    'pip install ".[pyqt]"',
    "python3 run.py",
    "python3 run.py test",
}


def test_every_line_is_one_that_is_tested() -> None:
    """What is not ours is known; ``run.py``'s two commands have tests of their own."""
    assert {line for line in LINES if not line.startswith("napari-elsplus ")} == OTHERS
    assert ELSEWHERE in LINES


def test_the_first_visit_works_as_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for line in LINES:
        if line.startswith("napari-elsplus ") and line != ELSEWHERE:
            left = 0
            try:
                main(shlex.split(line)[1:])
            except SystemExit as exit_of_command:
                left = exit_of_command.code or 0
            assert left == 0, line
    (snippet,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    exec(compile(snippet, "README.md", "exec"), {})
    assert (tmp_path / "track-again.csv").is_file()
    promised = {word for line in LINES for word in re.findall(r"-o (\S+)|--track (\S+)", line) for word in word if word}
    assert promised
    assert {name for name in promised if not (tmp_path / name).exists()} == set()


def test_links_lead_somewhere() -> None:
    targets = [target for target in re.findall(r"\]\(([^)]+)\)", README) if "://" not in target]
    assert targets
    assert [target for target in targets if not (PROJECT / target).exists()] == []
