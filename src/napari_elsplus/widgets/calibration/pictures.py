"""Each step of the calibration in words and plots."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from napari_elsplus.processing.analysis.image_quality import PAPER_ALIGNMENT_PERCENT
from napari_elsplus.processing.calibration.calibrate import Background, SlitOffset
from napari_elsplus.processing.calibration.draft import MOVED_ROWS, Draft, Flat, LitPair, Setup, Step, StepResult
from napari_elsplus.processing.calibration.galvo import PAPER_VOLTAGES, GalvoMap
from napari_elsplus.processing.calibration.lag import ScanLag
from napari_elsplus.widgets.calibration.offset_picture import offset_picture
from napari_elsplus.widgets.calibration.picture import Picture, Plot, told
from napari_elsplus.widgets.shared.plots import Curve

if TYPE_CHECKING:
    from numpy.typing import NDArray


def picture(found: StepResult, draft: Draft, setup: Setup, target_um: float) -> Picture:
    """Say and draw what a step found.

    Parameters
    ----------
    found : SlitOffset, GalvoMap, LitPair, ScanLag, Background or Flat
        What was found.
    draft : Draft
        What was known before.
    setup : Setup
        What it was measured with.
    target_um : float
        Slit offset that is wanted, without its sign.
    """
    match found:
        case SlitOffset():
            return offset_picture(found, draft, setup, target_um)
        case GalvoMap():
            return _galvo(found)
        case LitPair():
            return _pair(found, draft, setup)
        case ScanLag():
            return _lag(found, setup)
        case Background():
            return _background(found)
        case Flat():
            return _flat(found)


def _galvo(found: GalvoMap) -> Picture:
    ends = np.array([found.volts.min(), found.volts.max()])
    misses = found.rows - (found.volts - found.volts_at_row_zero) / found.volts_per_row
    frames = len(found.volts) + found.dark
    lines = [
        f"{told(1e3 * found.volts_at_row_zero, 1e3 * found.volts_at_row_zero_uncertainty)} mV at row 0, "
        f"tilt {found.tilt_deg:.2f}°",
        f"R² {found.r_squared:.6f}, residuals {found.rms_rows:.3f} rows RMS",
        f"{found.lines} of {frames} voltages fitted, {found.dark} without a whole line, {found.outliers} outliers",
    ]
    warnings = []
    if found.curved:
        warnings.append(f"the galvo is not linear: it departs by up to {found.curvature_rows:.2f} rows")
    if frames < PAPER_VOLTAGES:
        warnings.append(f"{frames} voltages; the paper takes at least {PAPER_VOLTAGES}")
    used = found.used
    plots = [
        Plot(
            "voltage / V",
            "row",
            [
                Curve("measured", found.volts, found.rows, "blue", "none", marks=True),
                Curve("fit", ends, (ends - found.volts_at_row_zero) / found.volts_per_row, "orange"),
            ],
        ),
        Plot(
            "voltage / V",
            "residual / rows",
            [Curve("residual", found.volts[used], misses[used], "blue", "none", marks=True, listed=False)],
        ),
    ]
    per_row = told(1e3 * found.volts_per_row, 1e3 * found.volts_per_row_uncertainty)
    return Picture(f"{per_row}<br>mV per row", lines, warnings, plots)


def _pair(found: LitPair, draft: Draft, setup: Setup) -> Picture:
    accepted = draft if draft.found.get(Step.PAIR) is found else draft.take(found, setup)
    known, pair = accepted.calibration, found.pair
    alignment = pair.alignment
    evidence = ", ".join(f"{name} {extra:+.0f}" for name, extra in alignment.evidence.items())
    lines = [
        f"{name}: {disc.centre[0]:.2f}, {disc.centre[1]:.2f} ± {disc.centre_uncertainty_px:.2f}, "
        f"Ø {disc.diameter_px:.2f} ± {disc.diameter_uncertainty_px:.2f} px"
        for name, disc in (("confocal", pair.left), ("residual", pair.right))
    ]
    lines.append(f"right onto left: {alignment.model} to {alignment.uncertainty_px:.3f} px (BIC: {evidence})")
    lines.append(f"gain of the right view {told(alignment.gain, alignment.gain_uncertainty)}")
    warnings = []
    if known.offset is not None:
        apart = known.offset.rows - found.offset_rows
        lines.append(
            f"offset: {told(known.offset.rows, known.offset.uncertainty_rows)} rows by the line, "
            f"{told(found.offset_rows, found.offset_uncertainty_rows)} by the bundle"
        )
        if abs(apart) > MOVED_ROWS:
            warnings.append(f"the two offsets differ by {apart:.1f} rows: measure the slit offset again")
    if known.galvo is not None and known.galvo.park_v is not None:
        lines.append(f"park voltage {known.galvo.park_v:.4f} V")
    headline = f"{alignment.model}, {alignment.uncertainty_px:.3f} px"
    if known.quality is not None:
        raw, filtered = 100 * known.quality.alignment_error, 100 * known.quality.alignment_error_filtered
        headline = f"alignment error {raw:.1f} %<br>{filtered:.2f} % after the filter"
        paper = PAPER_ALIGNMENT_PERCENT
        lines.append(f"the paper's alignment error: {paper[0]} %, {paper[1]} % after its filter")
    return Picture(headline, lines, warnings, [_across(found)])


def _across(found: LitPair) -> Plot:
    """Grey levels across both discs, on one another."""
    curves = []
    for name, disc, colour, dash in (
        ("confocal", found.pair.left, "blue", "solid"),
        ("residual", found.pair.right, "orange", "dotted"),
    ):
        band = found.image[max(round(disc.centre[0]) - 5, 0) : round(disc.centre[0]) + 6].mean(axis=0)
        cols = np.arange(len(band)) - disc.centre[1]
        near = np.abs(cols) < 0.55 * disc.diameter_px
        curves.append(Curve(name, cols[near], band[near], colour, dash))
    radius = found.pair.left.diameter_px / 2
    return Plot("columns from the centre", "grey levels", curves, [(-radius, "grey", ""), (radius, "grey", "")])


def _lag(found: ScanLag, setup: Setup) -> Picture:
    order = np.argsort(found.leads_s)
    lines = []
    if setup.line_period_s is not None:
        rows, spread = found.lag_s / setup.line_period_s, found.uncertainty_s / setup.line_period_s
        lines.append(f"{told(rows, spread)} rows: so far the scan runs ahead of the slit")
    curve = Curve("signal", 1e6 * found.leads_s[order], found.signal[order], "blue", marks=True, listed=False)
    mark = (1e6 * found.lag_s, "orange", f"{1e6 * found.lag_s:.1f} µs")
    plot = Plot("lead / µs", "confocal signal / grey levels", [curve], [mark])
    return Picture(f"{told(1e6 * found.lag_s, 1e6 * found.uncertainty_s)} µs", lines, (), [plot])


def _background(found: Background) -> Picture:
    lines = [f"{found.frames} frames, drift {100 * found.drift:.2f} %, less than 1 % saturated"]
    curves = [
        Curve("rows", np.arange(float(len(found.mean))), found.mean.mean(axis=1), "blue"),
        Curve("columns", np.arange(float(found.mean.shape[1])), found.mean.mean(axis=0), "orange", "dotted"),
    ]
    plot = Plot("row, column", "grey levels", curves)
    return Picture(f"{float(found.mean.mean()):.2f} grey levels", lines, (), [plot])


def _flat(found: Flat) -> Picture:
    image = found.image
    middle = len(image) // 2
    at = np.arange(len(image)) - (len(image) - 1) / 2
    curves = [
        Curve("rows", at, _band(image, middle), "blue"),
        Curve("columns", at, _band(image.T, middle), "orange", "dotted"),
    ]
    inside = np.hypot(at[:, None], at) < 0.45 * len(image)
    unevenness = float(image[inside].std())
    return Picture(
        f"{100 * unevenness:.1f} % uneven",
        ["standard deviation in the 90 % disc, cores included"],
        (),
        [Plot("pixels from the centre", "relative brightness", curves)],
    )


def _band(image: NDArray[np.float32], middle: int) -> NDArray[np.float32]:
    band: NDArray[np.float32] = image[middle - 5 : middle + 6].mean(axis=0)
    return band
