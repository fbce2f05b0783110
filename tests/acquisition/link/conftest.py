"""An engine's process on a rig of a few lines, and the log of its galvo."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """File of the voltages that the galvo was commanded."""
    path = tmp_path / "mirror.log"
    path.touch()
    return path


@pytest.fixture
def command(log: Path) -> tuple[str, ...]:
    return (sys.executable, str(Path(__file__).parents[1] / "engine_process.py"), str(log))
