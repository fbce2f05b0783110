"""``napari-elsplus``, run in this process."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from commands import Run, runner
from napari_elsplus.cli import elsplus as program


@pytest.fixture
def elsplus(capsys: pytest.CaptureFixture[str]) -> Callable[..., Run]:
    """Run ``napari-elsplus`` with arguments of any type and return how it ended."""
    return runner(program, "napari-elsplus", capsys)
