"""Bar of the probe's speed relative to the largest trackable speed."""

from __future__ import annotations

from math import isfinite
from typing import TYPE_CHECKING, Final

from qtpy.QtWidgets import QProgressBar, QVBoxLayout, QWidget

from napari_elsplus.widgets.shared.panel import text_label
from napari_elsplus.widgets.shared.plots import theme_colour

if TYPE_CHECKING:
    from napari_elsplus.viewing.mosaic.track import Speed

WARNING_SPEED_SHARE: Final = 0.5
"""Fraction of the limit above which a warning is shown; chosen."""
MAX_SPEED_SHARE: Final = 0.8
"""Fraction of the limit above which the speed is shown as too high; chosen, a fifth is left for acceleration."""
MIN_TRACKED_SHARE: Final = 0.5
"""Fraction of the latest frames tracked below which the track is being lost; chosen."""


class SpeedBar(QWidget):
    """A bar with a text below it.

    Parameters
    ----------
    theme : str
        Name of napari's theme.
    """

    def __init__(self, theme: str) -> None:
        super().__init__()
        self._bar, self._label = QProgressBar(), text_label()
        self._bar.setRange(0, 100)
        self._bar.setTextVisible(False)
        self._bar.setMaximumHeight(12)
        self.setToolTip(
            "Speed of the probe; at the end of the bar successive frames overlap too little to be tracked. "
            "Stay below half, slower over tissue of low contrast."
        )
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.addWidget(self._bar)
        layout.addWidget(self._label)
        self.apply_theme(theme)
        self.show_speed(None)

    @property
    def text(self) -> str:
        """Text below the bar."""
        return self._label.text()

    def apply_theme(self, theme: str) -> None:
        """Use the colours of a napari theme, given by name, from the next speed on."""
        self._theme = theme

    def show_speed(self, speed: Speed | None, *, growing: bool = False) -> None:
        """Show a speed; None hides the bar.

        Parameters
        ----------
        speed : Speed or None
            Of the latest frames; None without a mosaic.
        growing : bool
            Frames with light are being inserted, so that a track can be lost.
        """
        self.setVisible(speed is not None)
        losing = growing and speed is not None and speed.tracked < MIN_TRACKED_SHARE
        if speed is None or not (isfinite(speed.share) or losing):
            self._fill(0)
            self._label.setText("speed: not measured yet")
            return
        share = speed.share if isfinite(speed.share) else 1.0
        colour = (
            "vermilion" if losing or share > MAX_SPEED_SHARE else "orange" if share > WARNING_SPEED_SHARE else "green"
        )
        self._fill(round(100 * min(share, 1.0)))
        self._set_colour(theme_colour(self._theme, colour))
        self._label.setText(_speed_text(speed, losing=losing))

    def _fill(self, percent: int) -> None:
        """Set the bar's value without an immediate repaint, which QProgressBar forces."""
        self._bar.setUpdatesEnabled(False)
        self._bar.setValue(percent)
        self._bar.setUpdatesEnabled(True)

    def _set_colour(self, colour: str) -> None:
        """Set the bar's colour, if it differs: a new style sheet is expensive."""
        sheet = f"QProgressBar::chunk {{ background-color: {colour}; }}"
        if self._bar.styleSheet() != sheet:
            self._bar.setStyleSheet(sheet)


def _speed_text(speed: Speed, *, losing: bool) -> str:
    if losing:
        return "<b>Track is being lost</b>: move more slowly, or return to the end of the mosaic."
    if isfinite(speed.um_per_s):
        text = f"speed {speed.um_per_s / 1000:.1f} mm/s (limit {speed.max_um_per_s / 1000:.0f})"
    else:
        text = f"speed {speed.px_per_frame:.0f} px/frame (limit {speed.max_px_per_frame:.0f})"
    if speed.share > MAX_SPEED_SHARE:
        return f"{text}: <b>too fast</b>"
    return f"{text}: near the limit" if speed.share > WARNING_SPEED_SHARE else text
