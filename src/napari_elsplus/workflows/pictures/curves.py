"""Curves and shaded ranges of a line plot as plain data, for plots on the screen and in files; their colours."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from napari_elsplus.processing.images.modes import Mode

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


PAPER_COLOURS: Final = {
    "blue": "#0072b2", "orange": "#e69f00", "green": "#009e73", "grey": "#7f7f7f", "vermilion": "#d55e00",
    "purple": "#cc79a7",
}  # fmt: skip
"""Colours of curves on white paper: of Okabe and Ito's palette, distinguishable with colour-vision deficiency."""
MODE_COLOURS: Final = {Mode.LS: "blue", Mode.ELSA: "orange", Mode.ELS: "green"}
MODE_DASHES: Final = {Mode.LS: "dotted", Mode.ELSA: "dashed", Mode.ELS: "solid"}
"""Colours and dashes of compared images."""


@dataclass(frozen=True)
class Curve:
    """A line in a plot.

    Attributes
    ----------
    name : str
        Its entry in the legend, and its column in a CSV file.
    x, y : numpy.ndarray
        (m,) each.
    colour : str
        A key of `PAPER_COLOURS`.
    dash : str
        ``solid``, ``dashed``, ``dotted`` or ``none``; distinguishes curves without colour.
    marks : bool
        Mark each point.
    listed : bool
        List it in the legend.
    """

    name: str
    x: NDArray[np.floating]
    y: NDArray[np.floating]
    colour: str
    dash: str = "solid"
    marks: bool = False
    listed: bool = True


@dataclass(frozen=True)
class Band:
    """A shaded range of x, from one position to the other, in a colour as a curve has it."""

    start: float
    stop: float
    colour: str
