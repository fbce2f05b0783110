"""Widgets need a screen, real or virtual."""

from __future__ import annotations

import os
import sys

import pytest
from napari.utils.notifications import notification_manager


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    if sys.platform.startswith("linux") and not {"DISPLAY", "WAYLAND_DISPLAY"} & set(os.environ):
        for item in items:
            if "widgets" in item.path.parts:
                item.add_marker(pytest.mark.skip("no screen, and Qt would end the whole run: start under xvfb-run"))


@pytest.fixture
def said():
    """What napari was told to show, as (severity, message)."""
    before = len(notification_manager.records)
    return lambda: [(r.severity.value, r.message) for r in notification_manager.records[before:]]
