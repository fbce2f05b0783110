"""The instrument drawn: laser line, galvo, bundle, and one camera that sees the bundle twice."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyBboxPatch, Rectangle

if TYPE_CHECKING:
    from matplotlib.axes import Axes

EXCITATION, EMISSION, CONFOCAL, RESIDUAL = "#0072b2", "#009e73", "#0072b2", "#d55e00"


class Part(NamedTuple):
    """A part of the instrument: name, and the middle of its box."""

    name: str
    x: float
    y: float


PARTS: Final = (
    Part("laser, 488 nm,\ncollimator", 0.0, 2.0),
    Part("galvo", 1.6, 2.0),
    Part("cylindrical\nlens, relay", 3.2, 2.0),
    Part("dichroic", 4.8, 2.0),
    Part("objective", 6.4, 2.0),
    Part("fibre bundle,\nprobe", 8.2, 2.0),
    Part("tube lens,\n75 mm", 4.8, 0.7),
    Part("beam splitter,\ntilt mirror", 4.8, -0.6),
    Part("rolling-shutter\ncamera", 4.8, -1.9),
)
_WAYS: Final = (
    (((0.0, 2.0), (8.2, 2.0)), EXCITATION, 0.05),
    (((8.2, 2.0), (4.8, 2.0)), EMISSION, -0.07),
    (((4.8, 2.0), (4.8, -1.9)), EMISSION, 0.0),
)
"""Ways of the light: ends, colour, and distance from the axis by which it is drawn."""


def draw_schematic() -> Figure:
    """Draw the optical path, and the two views on the camera with their slits at one moment of a frame."""
    figure = Figure(figsize=(11, 5.4), layout="constrained")
    path, sensor = figure.subplots(1, 2, width_ratios=(1.7, 1))
    _draw_path(path)
    _draw_sensor(sensor)
    return figure


def _draw_path(axes: Axes) -> None:
    for ((x0, y0), (x1, y1)), colour, aside in _WAYS:
        axes.annotate(
            "", (x1, y1 + aside), (x0, y0 + aside), arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 2}
        )
    for part in PARTS:
        axes.add_patch(
            FancyBboxPatch((part.x - 0.62, part.y - 0.3), 1.24, 0.6, "round,pad=0.02", fc="white", ec="0.3", zorder=3)
        )
        axes.text(part.x, part.y, part.name, ha="center", va="center", fontsize=8, zorder=4)
    axes.text(1.6, 2.5, "excitation: a line, scanned over the bundle by the galvo", fontsize=8, color=EXCITATION)
    axes.text(5.6, 0.7, "fluorescence, not descanned", fontsize=8, color=EMISSION, va="center")
    axes.text(5.6, -0.6, "two views side by side,\none of them shifted by the slit offset", fontsize=8, va="center")
    axes.set(xlim=(-0.8, 9.2), ylim=(-2.5, 2.9), aspect="equal", title="Instrument")
    axes.set_axis_off()


def _draw_sensor(axes: Axes) -> None:
    radius, offset, slit, line = 1.0, 0.28, 0.09, 0.25
    for name, x, colour, line_at in (("confocal", -1.2, CONFOCAL, line), ("residual", 1.2, RESIDUAL, line - offset)):
        centre = (x, line_at - line)
        axes.add_patch(Circle(centre, radius, fc="0.93", ec="0.4"))
        half = float(np.sqrt(radius**2 - line**2))
        axes.plot([x - half, x + half], [line_at, line_at], color=EMISSION, lw=3)
        axes.text(x, centre[1] + radius + 0.2, f"{name} view", ha="center", fontsize=9, color=colour)
    axes.add_patch(Rectangle((-2.35, line - slit / 2), 4.7, slit, fill=False, ec="0.1", hatch="////", lw=1))
    axes.text(-2.3, line + 0.2, "exposed rows:\nthe slit", fontsize=8, va="top")
    axes.annotate("", (2.4, line - offset), (2.4, line), arrowprops={"arrowstyle": "<->", "color": RESIDUAL})
    axes.text(2.45, line - offset / 2, "slit\noffset", fontsize=8, va="center", color=RESIDUAL)
    axes.annotate("", (-2.45, 0.9), (-2.45, -0.9), arrowprops={"arrowstyle": "-|>", "color": "0.4"})
    axes.text(-2.6, 0, "rows are read", fontsize=8, rotation=90, va="center", ha="right", color="0.4")
    axes.set(xlim=(-2.9, 3.0), ylim=(1.6, -1.5), aspect="equal", title="Camera, at one moment of a frame")
    axes.set_axis_off()
