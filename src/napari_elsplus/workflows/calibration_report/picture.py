"""A step's result as Calibration panel and report display it: its summary, a number to read from a distance, plots."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from napari_elsplus.processing.calibration.step import StepSummary

if TYPE_CHECKING:
    from collections.abc import Sequence

    from napari_elsplus.workflows.pictures.curves import Band, Curve


@dataclass(frozen=True)
class Plot:
    """One plot: labels of its axes, curves, vertical marks, shaded bands."""

    bottom: str
    left: str
    curves: Sequence[Curve]
    marks: Sequence[tuple[float, str, str]] = ()
    bands: Sequence[Band] = ()


@dataclass(frozen=True)
class Picture(StepSummary):
    """A summary with plots.

    Parameters
    ----------
    plots : sequence of Plot
        At most two.
    good : bool, optional
        True if the headline is within its target, False if it is not, None if it has no target.
    far : str
        The number to read from across the bench; empty for none.
    """

    plots: Sequence[Plot] = field(default_factory=tuple)
    good: bool | None = None
    far: str = ""
