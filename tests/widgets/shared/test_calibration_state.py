"""The active calibration as panels display it."""

from __future__ import annotations

import re

import pytest
from napari.utils.theme import get_theme
from qtpy.QtGui import QColor

from napari_elsplus.widgets.shared.calibration_state import amber

LEGIBLE = 4.5
"""Smallest ratio of luminances of text and what is behind it (WCAG 2.2, 1.4.3)."""


def luminance(colour: QColor) -> float:
    parts = [one / 12.92 if one <= 0.04045 else ((one + 0.055) / 1.055) ** 2.4 for one in colour.getRgbF()[:3]]
    return 0.2126 * parts[0] + 0.7152 * parts[1] + 0.0722 * parts[2]


@pytest.mark.parametrize("theme", ["dark", "light"])
def test_a_warning_is_legible_in_both_themes(theme):
    """Before: amber on the light theme, with a ratio of 1.8."""
    style = dict(re.findall(r"([a-z-]+): ?([#a-z0-9]+)", amber("x").split("style=")[1].split(">")[0]))
    behind = QColor(style.get("background-color") or get_theme(theme).background.as_hex())
    dark, light = sorted(luminance(QColor(one)) for one in (style["color"], behind))
    assert (light + 0.05) / (dark + 0.05) > LEGIBLE
