"""Plots of the calibration's steps, by the steps' keys."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from napari_elsplus.workflows.calibration_report.offset import offset_picture
from napari_elsplus.workflows.calibration_report.picture import Picture, Plot
from napari_elsplus.workflows.pictures.curves import Curve

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from napari_elsplus.processing.calibration.bundle.pair import BundlePair
    from napari_elsplus.processing.calibration.draft import Draft, Setup
    from napari_elsplus.processing.calibration.galvo import GalvoMap
    from napari_elsplus.processing.calibration.measurements import Background
    from napari_elsplus.processing.calibration.scan.lag import ScanLag
    from napari_elsplus.processing.calibration.step import CalibrationStep

BAND_PX: Final = 5
"""Pixels to either side of the middle that are averaged in a profile; chosen: about two cores."""
_SHOWN_ERROR_ROWS: Final = 10.0
"""Largest row error that is drawn for a scan without a correction; chosen: more would flatten the corrected one."""


def picture(
    step: CalibrationStep[Any], found: Any, draft: Draft, setup: Setup, target_um: float | None = None
) -> Picture:
    """Return the summary and the plots of a step's result.

    Parameters
    ----------
    step : CalibrationStep
        The step.
    found : object
        Its result.
    draft : Draft
        Results accepted before.
    setup : Setup
        Settings with which its frames were taken.
    target_um : float, optional
        Wanted slit offset in micrometres, without its sign.
    """
    summary = step.summary(draft, found, setup)
    if step.key == "offset":
        return offset_picture(found, summary, draft, setup, target_um)
    plots = PLOTS[step.key](found) if step.key in PLOTS else ()
    return Picture(summary.headline, summary.lines, summary.warnings, summary.details, plots)


def _galvo(found: GalvoMap) -> Sequence[Plot]:
    ends = np.array([found.volts.min(), found.volts.max()])
    misses, used = found.rows - found.row(found.volts), found.used
    return (
        Plot(
            "voltage / V",
            "row",
            [
                Curve("measured", found.volts, found.rows, "blue", "none", marks=True),
                Curve("fit", ends, np.asarray(found.row(ends)), "orange"),
            ],
        ),
        Plot(
            "voltage / V",
            "residual / rows",
            [Curve("residual", found.volts[used], misses[used], "blue", "none", marks=True, listed=False)],
        ),
    )


def _pair(found: BundlePair) -> Sequence[Plot]:
    """Return the grey levels across both discs, superposed."""
    curves = []
    for name, disc, colour, dash in (
        ("confocal", found.confocal, "blue", "solid"),
        ("residual", found.residual, "orange", "dotted"),
    ):
        band = _band(found.image, round(disc.centre[0]))
        cols = np.arange(len(band)) - disc.centre[1]
        near = np.abs(cols) < 0.55 * disc.diameter_px
        curves.append(Curve(name, cols[near], band[near], colour, dash))
    radius = found.confocal.diameter_px / 2
    return (Plot("columns from the centre", "grey levels", curves, [(-radius, "grey", ""), (radius, "grey", "")]),)


def _lag(found: ScanLag) -> Sequence[Plot]:
    order = np.argsort(found.leads_s)
    curve = Curve("signal", 1e6 * found.leads_s[order], found.signal[order], "blue", marks=True, listed=False)
    mark = (1e6 * found.lag_s, "orange", f"{1e6 * found.lag_s:.1f} µs")
    plots = [Plot("lead / µs", "confocal signal / grey levels", [curve], [mark])]
    if found.row_errors is not None:
        rows = np.arange(float(len(found.row_errors.rows)))
        curves = [Curve("row error", rows, found.row_errors.rows, "blue", listed=found.ramp is not None)]
        if found.ramp is not None:
            before = found.ramp.before.rows
            near = np.where(np.abs(before) < _SHOWN_ERROR_ROWS, before, np.nan)
            curves.append(Curve("before the correction", rows, near, "orange", "dotted"))
        plots.append(Plot("row", "line minus slit / rows", curves))
    return plots


def _background(found: Background) -> Sequence[Plot]:
    curves = [
        Curve("rows", np.arange(float(len(found.mean))), found.mean.mean(axis=1), "blue"),
        Curve("columns", np.arange(float(found.mean.shape[1])), found.mean.mean(axis=0), "orange", "dotted"),
    ]
    return (Plot("row, column", "grey levels", curves),)


def _flat_field(found: NDArray[np.float32]) -> Sequence[Plot]:
    middle, at = len(found) // 2, np.arange(len(found)) - (len(found) - 1) / 2
    curves = [
        Curve("rows", at, _band(found, middle), "blue"),
        Curve("columns", at, _band(found.T, middle), "orange", "dotted"),
    ]
    return (Plot("pixels from the centre", "relative brightness", curves),)


def _band(image: NDArray[np.float32], middle: int) -> NDArray[np.float32]:
    band: NDArray[np.float32] = image[max(middle - BAND_PX, 0) : middle + BAND_PX + 1].mean(axis=0)
    return band


PLOTS: Final[dict[str, Callable[[Any], Sequence[Plot]]]] = {
    "galvo": _galvo,
    "pair": _pair,
    "lag": _lag,
    "background": _background,
    "flat": _flat_field,
}
"""Returns at most two plots of a step's result, by the step's key; a step without an entry has a summary only."""
