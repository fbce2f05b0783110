"""What a step of the calibration shows: a number to read from across the bench, the numbers behind it, its plots."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import floor, inf, log10
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from napari_elsplus.widgets.shared.plots import Band, Curve


@dataclass(frozen=True)
class Plot:
    """One plot: labels of its axes, curves, vertical marks, shaded bands."""

    bottom: str
    left: str
    curves: Sequence[Curve]
    marks: Sequence[tuple[float, str, str]] = ()
    bands: Sequence[Band] = ()


@dataclass(frozen=True)
class Picture:
    """What a step shows.

    Parameters
    ----------
    headline : str
        The number that matters, with its uncertainty.
    far : str
        The number to read from across the bench, if there is one.
    lines : sequence of str
        The numbers behind it.
    warnings : sequence of str
        What is not as it should be.
    plots : sequence of Plot
        At most two.
    good : bool, optional
        Whether the headline is where it should be; None if nobody said where.
    """

    headline: str
    lines: Sequence[str] = ()
    warnings: Sequence[str] = ()
    plots: Sequence[Plot] = field(default_factory=tuple)
    good: bool | None = None
    far: str = ""


def told(value: float, spread: float) -> str:
    """Write a value to the first digit of its uncertainty, but no finer than a millionth.

    Examples
    --------
    >>> told(-21.7474, 0.0067), told(1.74836831, 0.00011)
    ('-21.747 ± 0.007', '1.7484 ± 0.0001')
    """
    digits = min(max(-floor(log10(spread)), 2), 6) if 0 < spread < inf else 2
    return f"{value:.{digits}f} ± {spread:.{digits}f}"
