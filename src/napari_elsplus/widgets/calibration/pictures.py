"""What each step shows: a number to read from across the bench, the numbers behind it, and its plots."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import floor, inf, log10
from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.evaluation.trade import line_as_seen, weigh
from napari_elsplus.optics import BUNDLE_UM
from napari_elsplus.processing.calibration.calibrate import Background, SlitOffset
from napari_elsplus.processing.calibration.draft import MOVED_ROWS, Draft, Flat, Found, LitPair, Setup, Step
from napari_elsplus.processing.calibration.galvo import PAPER_VOLTAGES, GalvoMap
from napari_elsplus.processing.calibration.lag import ScanLag
from napari_elsplus.processing.quality import PAPER_ALIGNMENT_PERCENT
from napari_elsplus.widgets.plots import Band, Curve

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from napari_elsplus.processing.calibration.line import Line

TOLERANCE_UM: Final = 1.0
"""Half the width of the green band around the target."""
_SLIT_ROWS: Final = 3.0
_FIT_WIDTHS: Final = 2.5
"""Standard deviations of the line to which its fit is drawn."""


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


def picture(found: Found, draft: Draft, setup: Setup, target_um: float) -> Picture:
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
            return _offset(found, draft, setup, target_um)
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


def scale_of(draft: Draft, setup: Setup) -> float | None:
    """Micrometres per pixel: measured, or what the objective should have."""
    return draft.um_per_px or setup.um_per_px


def _told(value: float, spread: float) -> str:
    """Write a value to the first digit of its uncertainty, but no finer than a millionth.

    Examples
    --------
    >>> _told(-21.7474, 0.0067), _told(1.74836831, 0.00011)
    ('-21.747 ± 0.007', '1.7484 ± 0.0001')
    """
    digits = min(max(-floor(log10(spread)), 2), 6) if 0 < spread < inf else 2
    return f"{value:.{digits}f} ± {spread:.{digits}f}"


def _offset(found: SlitOffset, draft: Draft, setup: Setup, target_um: float) -> Picture:
    scale = scale_of(draft, setup)
    slit_rows = setup.acquired_with.slit_rows or _SLIT_ROWS
    headline, far = f"{_told(found.rows, found.uncertainty_rows)} rows", f"{found.rows:.1f} rows"
    lines, warnings, bands, good = [], [], [], None
    radius_px = (BUNDLE_UM / scale if scale else found.left.columns[1] - found.left.columns[0]) / 2
    tilt, spread = found.left.tilt_deg, found.left.tilt_uncertainty_deg
    cost = abs(np.tan(np.radians(tilt))) * radius_px
    lines.append(f"tilt {_told(tilt, spread)}°: {cost:.1f} rows at the rim")
    if cost > slit_rows / 2:
        warnings.append(f"the tilt costs more than half the slit of {slit_rows:g} rows: turn the line level")
    if scale is not None:
        offset_um = found.rows * scale
        headline += f"<br>{_told(offset_um, found.uncertainty_rows * scale)} µm"
        far = f"{offset_um:.1f} µm"
        good = abs(abs(offset_um) - target_um) <= TOLERANCE_UM
        sign = -1 if found.rows < 0 else 1
        ends = sorted(sign * (target_um + side) / scale for side in (-TOLERANCE_UM, TOLERANCE_UM))
        bands.append(Band(ends[0], ends[1], "green"))
        lines += _trade(found, draft, setup, scale)
    if abs(found.rows) < slit_rows:
        warnings.append("the offset is smaller than the slit: the residual holds most of the signal")
    curves = [*_profile("left", found.left, 0.0, "blue"), *_profile("right", found.right, found.rows, "orange")]
    plot = Plot("rows from the confocal line", "grey levels", curves, bands=bands)
    return Picture(headline, lines, warnings, [plot], good, far)


def _trade(found: SlitOffset, draft: Draft, setup: Setup, scale: float) -> list[str]:
    if found.rows == 0:
        return ["without an offset ELS+ is zero everywhere"]
    slit_rows = setup.acquired_with.slit_rows or _SLIT_ROWS
    line = line_as_seen(found.left, slit_rows, scale)
    light_dn, gain_db = found.left.amplitude, setup.acquired_with.gain_db or 0.0
    given = weigh(found.rows * scale, slit_rows * scale, line, light_dn, gain_db=gain_db, bundle_um=draft.bundle_um)
    return [
        f"predicted drop-offs {given.drop_3db_um:.0f} µm (3 dB), {given.drop_10db_um:.0f} µm (10 dB)",
        f"signal kept {100 * given.signal_kept:.0f} %, contrast to noise {given.contrast_to_noise:.0f}, "
        f"{100 * given.clipped:.1f} % of the field clipped",
        f"with this line: {line.core_um:.1f} µm wide (SD), {light_dn:.0f} grey levels",
    ]


def _profile(name: str, line: Line, at_rows: float, colour: str) -> list[Curve]:
    rows = line.profile_rows
    near = np.abs(rows) < _FIT_WIDTHS * line.width_rows
    return [
        Curve(name, rows + at_rows, line.profile, colour, "none", marks=True),
        Curve(f"{name} fit", rows[near] + at_rows, line.fitted[near], colour, listed=False),
    ]


def _galvo(found: GalvoMap) -> Picture:
    ends = np.array([found.volts.min(), found.volts.max()])
    misses = found.rows - (found.volts - found.volts_at_row_zero) / found.volts_per_row
    frames = len(found.volts) + found.dark
    lines = [
        f"{_told(1e3 * found.volts_at_row_zero, 1e3 * found.volts_at_row_zero_uncertainty)} mV at row 0, "
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
    per_row = _told(1e3 * found.volts_per_row, 1e3 * found.volts_per_row_uncertainty)
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
    lines.append(f"gain of the right view {_told(alignment.gain, alignment.gain_uncertainty)}")
    warnings = []
    if known.offset is not None:
        apart = known.offset.rows - found.offset_rows
        lines.append(
            f"offset: {_told(known.offset.rows, known.offset.uncertainty_rows)} rows by the line, "
            f"{_told(found.offset_rows, found.offset_uncertainty_rows)} by the bundle"
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
        lines.append(f"{_told(rows, spread)} rows: so far the scan runs ahead of the slit")
    curve = Curve("signal", 1e6 * found.leads_s[order], found.signal[order], "blue", marks=True, listed=False)
    mark = (1e6 * found.lag_s, "orange", f"{1e6 * found.lag_s:.1f} µs")
    plot = Plot("lead / µs", "confocal signal / grey levels", [curve], [mark])
    return Picture(f"{_told(1e6 * found.lag_s, 1e6 * found.uncertainty_s)} µs", lines, (), [plot])


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
