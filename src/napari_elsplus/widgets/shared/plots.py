"""Line plots in the viewer's theme with a colour-blind-safe palette, saved as PNG or CSV."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pyqtgraph as pg
import pyqtgraph.exporters
from napari.utils.theme import get_theme
from qtpy.QtCore import QSize, Qt
from qtpy.QtGui import QFont
from qtpy.QtWidgets import QApplication

from napari_elsplus.errors import InputError
from napari_elsplus.io import replacing, write_table
from napari_elsplus.workflows.pictures.curves import Band, Curve

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

__all__ = ["Band", "Curve", "ThemedPlot", "theme_colour"]

PALETTE: Final = {
    "blue": ("#56b4e9", "#0072b2"),
    "orange": ("#e69f00", "#b87d00"),
    "green": ("#2bc48a", "#007a59"),
    "grey": ("#a0a0a0", "#6f6f6f"),
    "vermilion": ("#ff8a4d", "#c04a00"),
    "purple": ("#e6a0c8", "#a3568a"),
}
"""Hues of Okabe and Ito (2008), each for dark and for light backgrounds."""
DASHES: Final = {
    "none": Qt.PenStyle.NoPen,
    "solid": Qt.PenStyle.SolidLine,
    "dashed": Qt.PenStyle.DashLine,
    "dotted": Qt.PenStyle.DotLine,
}
EXPORT_WIDTH_PX: Final = 1600
"""Width of an exported picture, pixels: 300 dpi over 135 mm, a page's text width."""
MARGINS_PX: Final = (2, 8, 12, 2)
"""Left, top, right, bottom: half a tick label reaches over the end of its axis."""
MIN_CURVES_PX: Final = 140
"""Least height of curves with their axes, pixels; chosen: five tick labels fit."""
BOTTOM_PX: Final = 50
"""Height of the bottom axis with its labels and the margins, pixels."""
LEGEND_ROW_PX: Final = 16
"""Height of a row of the legend, pixels; chosen: a line of its font."""
_COLUMNS: Final = ((8, 3), (18, 2))
"""Most characters of a name, and columns of the legend that fit into a dock of 400 px then; else one."""


def theme_colour(theme: str, colour: str) -> str:
    """Return a colour of the palette as hex, for the background of a theme.

    Parameters
    ----------
    theme : str
        Name of a napari theme.
    colour : str
        A key of `PALETTE`.
    """
    return PALETTE[colour][0 if get_theme(theme).type == "dark" else 1]


class ThemedPlot(pg.PlotWidget):  # type: ignore[misc]
    """A plot that follows the viewer's theme.

    Parameters
    ----------
    x_label, y_label : str
        What is plotted, with its unit.
    theme : str
        Name of napari's theme.
    """

    def __init__(self, x_label: str, y_label: str, theme: str) -> None:
        others = set(QApplication.topLevelWidgets())
        super().__init__(enableMenu=False)
        for menu in set(QApplication.topLevelWidgets()) - others - {self}:
            menu.setParent(self, menu.windowFlags())  # pyqtgraph leaves its menus behind without an owner
        self._labels = {"bottom": x_label, "left": y_label}
        self._curves: list[Curve] = []
        self._marks: list[tuple[float, str, str]] = []
        self._bands: list[Band] = []
        self._drawn_as: object = None
        self._legend_px = 0
        self._lines: list[Any] = []
        self._regions: list[Any] = []
        self.hideButtons()
        self.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.setMouseEnabled(x=False, y=False)  # there is no way back from a zoom, and the wheel scrolls the panel
        self.plotItem.layout.setContentsMargins(*MARGINS_PX)
        self._legend = pg.LegendItem(colCount=4, labelTextSize="8pt", verSpacing=-4)
        self.plotItem.layout.addItem(self._legend, 4, 1)  # below the curves, where it hides none
        self.plotItem.legend = self._legend
        self.apply_theme(theme)

    def sizeHint(self) -> QSize:
        """Return a size that fits into a dock."""
        return QSize(280, 220)

    def minimumSizeHint(self) -> QSize:
        """Return a size in which curves, axes and legend do not cover each other."""
        label_px = (
            int(self.getAxis("left").label.boundingRect().width()) if self._curves else 0
        )  # it is written upwards
        return QSize(0, max(MIN_CURVES_PX, label_px + BOTTOM_PX) + self._legend_px)

    @property
    def curves(self) -> tuple[Curve, ...]:
        """The curves that are drawn."""
        return tuple(self._curves)

    def apply_theme(self, theme: str) -> None:
        """Redraw in the colours of a napari theme, given by name."""
        colours = get_theme(theme)
        self._theme = theme
        self._text = colours.text.as_hex()
        self.setBackground(colours.background.as_hex())
        font = QFont()
        font.setPointSize(8)
        for side in ("bottom", "left"):
            axis = self.getAxis(side)
            axis.setPen(self._text)
            axis.setTextPen(self._text)
            axis.setTickFont(font)
            axis.label.setFont(font)
        self._legend.setLabelTextColor(self._text)
        self.draw(self._curves, marks=self._marks, bands=self._bands, **self._labels)

    def draw(
        self,
        curves: Sequence[Curve],
        *,
        marks: Sequence[tuple[float, str, str]] = (),
        bands: Sequence[Band] = (),
        bottom: str | None = None,
        left: str | None = None,
    ) -> None:
        """Replace the plot's content.

        Parameters
        ----------
        curves : sequence of Curve
            What to draw.
        marks : sequence of tuple
            Vertical lines: position, colour, text.
        bands : sequence of Band
            Shaded behind the curves.
        bottom, left : str, optional
            New labels of the axes.
        """
        self._curves, self._marks, self._bands = list(curves), list(marks), list(bands)
        before, self._drawn_as = self._drawn_as, self._structure(bottom, left)
        if before == self._drawn_as:
            self._update_data()
            return
        self._labels |= {side: text for side, text in (("bottom", bottom), ("left", left)) if text is not None}
        for side, text in self._labels.items():
            self.setLabel(
                side, text, siPrefixEnableRanges=(), color=self._text
            )  # no SI prefix: the label states the unit
            self.getAxis(side).resizeEvent()  # centres the new text
            self.showAxis(side, bool(self._curves))  # which `setLabel` shows always
        self.plotItem.clear()
        self._regions, self._lines = [], []
        for band in self._bands:
            brush = pg.mkBrush(self.colour(band.colour) + "50")
            self._regions.append(
                pg.LinearRegionItem((band.start, band.stop), brush=brush, pen=pg.mkPen(None), movable=False)
            )
            self.addItem(self._regions[-1])
        names = [curve.name for curve in self._curves if curve.listed]
        longest = max(map(len, names), default=0)
        columns = next((count for most, count in _COLUMNS if longest <= most), 1)
        self._legend.setColumnCount(columns)
        self._legend_px = LEGEND_ROW_PX * -(-len(names) // columns)
        self.updateGeometry()
        for curve in self._curves:
            ink = self.colour(curve.colour)
            pen = pg.mkPen(ink, width=2, style=DASHES[curve.dash])
            symbol = {"symbol": "o", "symbolSize": 5, "symbolBrush": ink, "symbolPen": None} if curve.marks else {}
            name = curve.name if curve.listed else None
            self._lines.append(self.plot(np.asarray(curve.x), np.asarray(curve.y), pen=pen, name=name, **symbol))
        for index, (position, colour, text) in enumerate(self._marks):
            options: dict[str, Any] = {
                "position": 0.92 - 0.13 * (index % 4),
                "color": self.colour(colour),
                "fill": None,
            }
            pen = pg.mkPen(self.colour(colour), width=1, style=Qt.PenStyle.DotLine)
            self.addItem(pg.InfiniteLine(position, angle=90, pen=pen, label=text, labelOpts=options))
        self.plotItem.layout.invalidate()  # the legend moves itself to the top when it changes its size
        self.plotItem.layout.activate()

    def _structure(self, bottom: str | None, left: str | None) -> object:
        """Return all of a plot but its numbers."""
        curves = [(curve.name, curve.colour, curve.dash, curve.marks, curve.listed) for curve in self._curves]
        return curves, self._marks, [band.colour for band in self._bands], bottom, left, self._theme

    def _update_data(self) -> None:
        """Replace the numbers of what is drawn, without relayout of axes and legend."""
        for line, curve in zip(self._lines, self._curves, strict=True):
            line.setData(np.asarray(curve.x), np.asarray(curve.y))
        for region, band in zip(self._regions, self._bands, strict=True):
            region.setRegion((band.start, band.stop))

    def colour(self, colour: str) -> str:
        """Return a colour of the palette as hex, for the present background."""
        return theme_colour(self._theme, colour)

    def save(self, path: str | Path) -> None:
        """Save the plot as a picture (NAME.png) or its numbers as a table (NAME.csv); an existing file is replaced.

        Parameters
        ----------
        path : path-like
            Ends in ``.png`` or ``.csv``.

        Raises
        ------
        InputError
            If nothing is drawn, or the path has another suffix.
        """
        path = Path(path)
        if not self._curves:
            raise InputError("the plot is empty", "draw a line, or measure, first")
        if path.suffix.lower() == ".csv":
            write_table(path, self.columns(), force=True)
        elif path.suffix.lower() == ".png":
            exporter = pg.exporters.ImageExporter(self.plotItem)
            exporter.parameters()["width"] = EXPORT_WIDTH_PX
            with replacing(path, force=True) as beside:
                exporter.export(str(beside))
        else:
            raise InputError(f"{path.name} is neither a picture nor a table", "give it the suffix .png or .csv")

    def columns(self) -> dict[str, NDArray[np.floating]]:
        """Return the curves as the columns of a table; a shared x is written once."""
        table: dict[str, NDArray[np.floating]] = {}
        shared = all(np.array_equal(curve.x, self._curves[0].x) for curve in self._curves)
        for curve in self._curves:
            if shared:
                table.setdefault(self._labels["bottom"], curve.x)
            else:
                table[f"{curve.name}: {self._labels['bottom']}"] = curve.x
            table[curve.name] = curve.y
        return {name.replace(",", ";"): values for name, values in table.items()}
