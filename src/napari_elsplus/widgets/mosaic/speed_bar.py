"""How fast may I go? The probe's speed as a bar up to the fastest that can be followed."""

from __future__ import annotations

from math import isfinite
from typing import TYPE_CHECKING, Final

from qtpy.QtWidgets import QLabel, QProgressBar, QVBoxLayout, QWidget

from napari_elsplus.widgets.shared.plots import ink_on

if TYPE_CHECKING:
    from napari_elsplus.viewing.mosaic.track import Speed

SLOWER: Final = 0.5
"""Part of the fastest from which on the user is warned."""
TOO_FAST: Final = 0.8
LOSING: Final = 0.5
"""Less than this part of the latest frames tracked: the track is being lost."""


class SpeedBar(QWidget):
    """A bar with words below it.

    Parameters
    ----------
    theme : str
        Name of napari's theme.
    """

    def __init__(self, theme: str) -> None:
        super().__init__()
        self._bar, self._words = QProgressBar(), QLabel()
        self._bar.setRange(0, 100)
        self._bar.setTextVisible(False)
        self._bar.setMaximumHeight(12)
        self._words.setWordWrap(True)
        self.setToolTip(
            "The probe's speed; at the bar's end successive frames overlap too little to be followed. "
            "Stay below half, slower where there is little to see."
        )
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.addWidget(self._bar)
        layout.addWidget(self._words)
        self.follow(theme)
        self.show_speed(None)

    @property
    def text(self) -> str:
        """What it says."""
        return self._words.text()

    def follow(self, theme: str) -> None:
        """Take the colours of one of napari's themes."""
        self._theme = theme

    def show_speed(self, speed: Speed | None) -> None:
        """Show a speed; None if nothing moves."""
        if speed is None or not (isfinite(speed.share) or speed.tracked < LOSING):
            self._fill(0)
            self._words.setText("Speed: not known yet.")
            return
        share = speed.share if isfinite(speed.share) else 1.0
        losing = speed.tracked < LOSING
        colour = "vermilion" if losing or share > TOO_FAST else "orange" if share > SLOWER else "green"
        self._fill(round(100 * min(share, 1.0)))
        self._paint(ink_on(self._theme, colour))
        self._words.setText(_said(speed, losing=losing))

    def _fill(self, percent: int) -> None:
        """Fill the bar, to be painted with the next look at the window: by itself it paints all of that at once."""
        self._bar.setUpdatesEnabled(False)
        self._bar.setValue(percent)
        self._bar.setUpdatesEnabled(True)

    def _paint(self, ink: str) -> None:
        """Change the bar's colour; a new style sheet is dear, so only where it differs."""
        sheet = f"QProgressBar::chunk {{ background-color: {ink}; }}"
        if self._bar.styleSheet() != sheet:
            self._bar.setStyleSheet(sheet)


def _said(speed: Speed, *, losing: bool) -> str:
    if losing:
        return "<b>The track is being lost</b>: slower, or go back to where the mosaic ends."
    if isfinite(speed.um_per_s):
        now = f"{speed.um_per_s / 1000:.1f} mm/s of at most {speed.fastest_um_per_s / 1000:.0f} mm/s"
    else:
        now = f"{speed.px_per_frame:.0f} px per frame of at most {speed.fastest_px:.0f}"
    if speed.share > TOO_FAST:
        return f"{now}. <b>Too fast: slower.</b>"
    return f"{now}. Better slower." if speed.share > SLOWER else f"{now}."
