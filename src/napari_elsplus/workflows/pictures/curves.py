"""Curves and shaded ranges of a line plot as plain data, for plots on the screen and in files."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


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
        ``blue``, ``orange``, ``green``, ``grey``, ``vermilion`` or ``purple``.
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
