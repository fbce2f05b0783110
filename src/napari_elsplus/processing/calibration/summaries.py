"""Results of the calibration's steps in words: numbers with their uncertainties."""

from __future__ import annotations

from math import floor, inf, log10
from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.processing.analysis.image_quality import USED_DIAMETER
from napari_elsplus.processing.calibration.bundle.cancellation import PAPER_TEXT, measure_alignment_errors
from napari_elsplus.processing.calibration.bundle.gain import mean_light
from napari_elsplus.processing.calibration.bundle.laser_gain import DOUBTFUL_DISAGREEMENT, LAMP_GAIN
from napari_elsplus.processing.calibration.bundle.location import MIN_CERTAIN_EDGE
from napari_elsplus.processing.calibration.bundle.pair import MAX_SATURATED, MAX_STRUCTURE
from napari_elsplus.processing.calibration.galvo import PAPER_VOLTAGES
from napari_elsplus.processing.calibration.line.clipping import MAX_CLIPPED_CORE
from napari_elsplus.processing.calibration.sections import in_lamp_light, structure_of_flat_field
from napari_elsplus.processing.calibration.slit_offset import MAX_OFFSET_DIFFERENCE_ROWS
from napari_elsplus.processing.calibration.step import StepSummary
from napari_elsplus.processing.images.sectioning import disc

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import BundleSection
    from napari_elsplus.processing.calibration.bundle.laser_gain import SweptLight
    from napari_elsplus.processing.calibration.bundle.location import Disc
    from napari_elsplus.processing.calibration.bundle.pair import BundlePair
    from napari_elsplus.processing.calibration.bundle.view_alignment import Alignment
    from napari_elsplus.processing.calibration.draft import Draft, Setup
    from napari_elsplus.processing.calibration.galvo import GalvoMap
    from napari_elsplus.processing.calibration.measurements import Background
    from napari_elsplus.processing.calibration.scan.lag import ScanLag
    from napari_elsplus.processing.calibration.scan.learned_ramp import LearnedRamp
    from napari_elsplus.processing.calibration.slit_offset import SlitOffset

MAX_OUTLIERS: Final = 0.1
"""Share of the lines of a sweep, beyond which those left out are warned of; chosen: chance leaves out a thousandth."""
MAX_GAIN_SPREAD: Final = 0.125
"""Standard deviation of the gain map, relative to its mean, above which a warning is given; measured: 0.09 with 10 %
from core to core and 10 % of vignette, 0.17 where a laser scanned fibres."""

MAX_BACKGROUND_LIGHT: Final = 0.25
"""Light of a background in the bundle, over that from its far end, above which a warning is given; measured: 0.016 to
0.03 in dark tubes of eight rigs; the bundle lit from its far end has 1."""


def with_uncertainty(value: float, uncertainty: float) -> str:
    """Format a value to the first digit of its uncertainty, but no finer than a millionth.

    Examples
    --------
    >>> with_uncertainty(-21.7474, 0.0067), with_uncertainty(1.74836831, 0.00011)
    ('-21.747 ± 0.007', '1.7484 ± 0.0001')
    """
    digits = min(max(-floor(log10(uncertainty)), 2), 6) if 0 < uncertainty < inf else 2
    return f"{value:.{digits}f} ± {uncertainty:.{digits}f}"


def summarize_offset(offset: SlitOffset, draft: Draft, setup: Setup) -> StepSummary:
    """Summarize a slit offset: rows and micrometres, tilt, rows at the rim; see :class:`CalibrationStep`."""
    scale, slit_rows = draft.um_per_px or setup.um_per_px, setup.acquired_with.slit_rows_or_default
    line, headline, warnings = offset.confocal, f"{with_uncertainty(offset.rows, offset.uncertainty_rows)} rows", []
    radius_px = (draft.bundle_um / scale if scale and draft.bundle_um else line.length_px) / 2
    cost = abs(np.tan(np.radians(line.tilt_deg))) * radius_px
    if scale is not None:
        headline += f"\n{with_uncertainty(offset.rows * scale, offset.uncertainty_rows * scale)} µm"
    if cost > slit_rows / 2:
        warnings.append(f"the tilt costs more than half the slit of {slit_rows:g} rows: turn the line level")
    if offset.clipped > MAX_CLIPPED_CORE:
        warnings.append(
            f"{100 * offset.clipped:.0f} % of the line's core is saturated: core and halo are not measured; "
            "lower the laser's power, the exposure or the gain"
        )
    if abs(offset.rows) < slit_rows:
        warnings.append("the offset is smaller than the slit: the residual contains most of the signal")
    tilt = with_uncertainty(line.tilt_deg, line.tilt_uncertainty_deg)
    return StepSummary(headline, [f"tilt {tilt}°: {cost:.1f} rows at the rim"], warnings)


def summarize_galvo(galvo: GalvoMap, draft: Draft, setup: Setup) -> StepSummary:
    """Summarize a galvo map: slope, intercept, fit, bow of the line, frames left out; see :class:`CalibrationStep`."""
    frames, warnings = len(galvo.volts) + galvo.dark, []
    lines = [
        f"{with_uncertainty(1e3 * galvo.volts_at_row_zero, 1e3 * galvo.volts_at_row_zero_uncertainty)} mV at row 0, "
        f"tilt {galvo.tilt_deg:.2f}°",
        f"R² {galvo.r_squared:.6f}, residuals {galvo.rms_rows:.3f} rows RMS, "
        f"± {galvo.middle_uncertainty_rows:.2g} rows at the middle of the sweep",
        f"bow of the line {with_uncertainty(galvo.bow_rows, galvo.bow_uncertainty_rows)} rows at the rim",
        f"{galvo.lines} of {frames} voltages fitted, {galvo.dark} without a whole line, {galvo.outliers} outliers",
    ]
    slit_rows = setup.acquired_with.slit_rows_or_default
    if abs(galvo.bow_rows) > slit_rows / 2:
        warnings.append(
            f"the line is bowed by {galvo.bow_rows:.1f} rows: its ends miss the slit of {slit_rows:g} rows; "
            "straighten it, or widen the slit"
        )
    offset = draft.calibration.offset
    if offset is not None and slit_rows <= abs(offset.rows) < slit_rows + abs(galvo.bow_rows):
        warnings.append(
            f"the bow reaches the slit of the residual view, {abs(offset.rows):.1f} rows from the line: ELS+ loses the "
            "signal at the rim; straighten the line, or enlarge the offset"
        )
    if galvo.curved:
        warnings.append(f"the galvo is not linear: it departs by up to {galvo.curvature_rows:.2f} rows")
    if galvo.outliers > MAX_OUTLIERS * (whole := galvo.lines + galvo.outliers):
        warnings.append(
            f"{galvo.outliers} of {whole} lines lie beside the straight line and are left out: does the galvo reach "
            "its limit, or follow the voltages late? Record the sweep again"
        )
    if galvo.light is not None and galvo.light.clipped:
        warnings.append(_clipped_lines(galvo.light))
    if frames < PAPER_VOLTAGES:
        warnings.append(f"{frames} voltages; the paper takes at least {PAPER_VOLTAGES}")
    per_row = with_uncertainty(1e3 * galvo.volts_per_row, 1e3 * galvo.volts_per_row_uncertainty)
    return StepSummary(f"{per_row} mV per row", lines, warnings)


def summarize_pair(pair: BundlePair, draft: Draft, _setup: Setup) -> StepSummary:
    """Summarize a bundle pair: centres, alignment, gain, alignment error, offset; see :class:`CalibrationStep`."""
    known, alignment, warnings = draft.calibration, pair.alignment, []
    evidence = ", ".join(f"{name} {extra:+.0f}" for name, extra in alignment.evidence.items())
    lines = [
        f"{name}: {view.centre[0]:.2f}, {view.centre[1]:.2f} ± {view.centre_uncertainty_px:.2f}, "
        f"Ø {view.diameter_px:.2f} ± {view.diameter_uncertainty_px:.2f} px"
        for name, view in (("confocal", pair.confocal), ("residual", pair.residual))
    ]
    if alignment.refusal:
        lines.append(f"view alignment: by the centres to {alignment.uncertainty_px:.1f} px")
        warnings.append(
            f"{alignment.refusal}: the views are aligned by their centres alone, as in the paper, to "
            f"{alignment.uncertainty_px:.1f} px; focus both views or brighten the light, then measure again"
        )
    else:
        lines.append(f"view alignment: {alignment.model} to {alignment.uncertainty_px:.3f} px")
    lines.append(_gain_text(known.bundle, alignment))
    warnings += _doubtful_gain(known.bundle, alignment.gain)
    if known.gain_map is not None:
        spread = float(known.gain_map.std())
        lines.append(f"gain map: {100 * spread:.1f} % over the field")
        if spread > MAX_GAIN_SPREAD:
            warnings.append(
                f"the gain of the residual view varies by {100 * spread:.0f} % over the field: is the bundle lit from "
                "its far end, the laser off? The residual view of a scanned target lacks the light from its focus"
            )
    warnings += _doubtful_image(pair, has_flat_field=known.flat is not None)
    if known.um_per_px is None:
        warnings.append("micrometres unknown: enter the diameter of the bundle")
    if known.offset is not None:
        lines.append(
            f"offset: {with_uncertainty(known.offset.rows, known.offset.uncertainty_rows)} rows from line and cores, "
            f"{with_uncertainty(pair.offset_rows, pair.offset_uncertainty_rows)} from the bundle images"
        )
        difference = known.offset.rows - pair.offset_rows
        if abs(difference) > MAX_OFFSET_DIFFERENCE_ROWS:
            warnings.append(f"the two offsets differ by {difference:.1f} rows: measure the slit offset again")
    if known.galvo is not None and known.galvo.park_v is not None:
        lines.append(f"park voltage {known.galvo.park_v:.4f} V")
    headline = f"{alignment.model}, {alignment.uncertainty_px:.3f} px"
    if known.quality is not None:
        raw, filtered = 100 * known.quality.alignment_error, 100 * known.quality.alignment_error_filtered
        cores = (known.quality.core_filter or "core").replace("gaussian", "Gaussian")
        headline = f"alignment error {raw:.2f} %\n{filtered:.2f} % after the {cores} filter"
        lines.append(measure_alignment_errors(pair.image, in_lamp_light(known, pair)).text)
        lines.append(PAPER_TEXT)
    details = [f"BIC of the models of view alignment: {evidence}"] if evidence else []
    return StepSummary(headline, lines, warnings, details)


def _doubtful_image(pair: BundlePair, *, has_flat_field: bool) -> Iterator[str]:
    """Yield a warning of each edge that is hardly seen or cut, and of an image that gives no flat field."""
    for name, view in (("confocal", pair.confocal), ("residual", pair.residual)):
        if view.edge_seen < MIN_CERTAIN_EDGE:
            yield (
                f"the edge of the {name} view is seen on {100 * view.edge_seen:.0f} % of its circumference only: "
                "is the target dark at the bundle's rim?"
            )
        if (share := seen_share(view, pair.image.shape)) < 1:
            yield (
                f"the frame's edge cuts the {name} view: {100 * share:.1f} % of its diameter is seen; there is no "
                f"residual beyond: record a larger region"
            )
    if not pair.shows_flat_field:
        saturated = f"{100 * pair.saturated:.0f} % of the image is saturated"
        what = saturated if pair.saturated > MAX_SATURATED else _varies(pair.structure)
        how = "the sweep gives it instead" if has_flat_field else "light the bundle evenly, or give a flat field"
        yield f"{what}: it gives no flat field; {how}"


def _gain_text(bundle: BundleSection | None, alignment: Alignment) -> str:
    """Return the gain, and in which light it was measured."""
    by_lamp = f"{with_uncertainty(alignment.gain, alignment.gain_uncertainty)} in the lamp's light"
    if bundle is None or bundle.residual_gain == alignment.gain:
        return f"gain of the residual view {by_lamp}; the fluorescence's may differ by {100 * LAMP_GAIN:g} %"
    in_laser_light = with_uncertainty(bundle.residual_gain, bundle.residual_gain_uncertainty or 0.0)
    return f"gain of the residual view {in_laser_light} in the light of the sweep, {by_lamp}"


def _clipped_lines(light: SweptLight) -> str:
    """Return how many lines of a sweep are saturated, what becomes of the residual view's gain, and the remedy."""
    what = (
        "so that it gives no gain of the residual view: the lamp's stays"
        if light.mostly_clipped
        else "which are left out of the gain of the residual view"
    )
    return (
        f"the line is saturated in {light.clipped} of {light.clipped + len(light.lines)} frames of the sweep, {what}; "
        "lower the laser's power, the exposure or the gain"
    )


def _doubtful_gain(bundle: BundleSection | None, lamp: float) -> list[str]:
    """Return a warning where the gains by sweep and lamp differ by more than their spectra do."""
    swept = None if bundle is None else bundle.swept_gain
    if swept is None or abs(swept / lamp - 1) <= DOUBTFUL_DISAGREEMENT:
        return []
    return [
        f"the gain of the residual view is {swept:.3f} in the light of the sweep, {lamp:.3f} in the lamp's: is a "
        "view saturated, out of focus or partly blocked in one of the recordings? Record both again"
    ]


def seen_share(disc: Disc, frame_shape: tuple[int, ...]) -> float:
    """Return the part of a disc's diameter that lies within the frame, along its rows or columns, the smaller.

    Parameters
    ----------
    disc : Disc
        Located bundle image.
    frame_shape : tuple of int
        Rows and columns of the frame.
    """
    radius = disc.diameter_px / 2
    beyond = [
        max(radius - 0.5 - at, 0) + max(at + radius + 0.5 - size, 0)
        for at, size in zip(disc.centre, frame_shape, strict=True)
    ]
    return 1 - max(beyond) / disc.diameter_px


def summarize_lag(lag: ScanLag, _draft: Draft, setup: Setup) -> StepSummary:
    """Summarize a scan lag: microseconds and rows, row errors, learned ramp; see :class:`CalibrationStep`."""
    lines: list[str] = []
    warnings: list[str] = []
    if setup.line_period_s is not None:
        rows = with_uncertainty(lag.lag_s / setup.line_period_s, lag.uncertainty_s / setup.line_period_s)
        lines.append(f"drive leads by {rows} rows")
    if lag.row_errors is not None:
        lines.append(f"row error at most {lag.row_errors.largest_rows:.2f} rows")
    if lag.ramp is not None:
        _add_ramp(lag.ramp, lines, warnings)
    return StepSummary(f"{with_uncertainty(1e6 * lag.lag_s, 1e6 * lag.uncertainty_s)} µs", lines, warnings)


def _add_ramp(ramp: LearnedRamp, lines: list[str], warnings: list[str]) -> None:
    """Add what a learned ramp corrects, and what the galvo cannot do."""
    galvo = f"galvo of {ramp.response.natural_hz:.0f} Hz, damping {ramp.response.damping:.2f}"
    if ramp.correction is not None:
        lines.append(
            f"ramp learned in {ramp.frames} frames: {ramp.off_before} rows missed the slit by more than "
            f"{ramp.limit_rows:g} rows before, {ramp.off} after"
        )
        lines.append(f"{galvo}, as far as this scan shows")
    if ramp.highest_rate_hz is not None:
        remedy = f"{ramp.highest_rate_hz:.0f} frames per second fit" if ramp.highest_rate_hz else "no frame rate fits"
        warnings.append(
            f"{ramp.off} rows miss the slit by more than {ramp.limit_rows:g} rows, and the {galvo}, cannot follow a "
            f"better ramp within the rig's limits: {remedy}"
        )
    elif ramp.off:
        warnings.append(
            f"{ramp.off} rows miss the slit by more than {ramp.limit_rows:g} rows: choose a lower frame rate"
        )


def summarize_background(background: Background, draft: Draft, _setup: Setup) -> StepSummary:
    """Summarize a background: its level and drift, light that is none of a dark tube; see :class:`CalibrationStep`.

    Autofluorescence and reflections of the fibres' faces are light of a dark tube.
    """
    lines = [f"{background.frames} frames, drift {100 * background.drift:.2f} %, less than 1 % saturated"]
    warnings, pair = [], draft.pair
    if background.line_row is not None:
        warnings.append(
            f"a line stands in the background, at row {background.line_row:.0f}: is this the dark tube, the line "
            "scanning? Record it again"
        )
    if pair is not None and pair.image.shape == background.mean.shape:
        share = mean_light(background.mean, pair.discs) / max(mean_light(pair.image, pair.discs), 1e-9)
        lines.append(f"light in the bundle {100 * share:.1f} % of that from its far end")
        if share > MAX_BACKGROUND_LIGHT:
            warnings.append(
                f"the bundle is {100 * share:.0f} % as bright in the background as lit from its far end: is this the "
                "dark tube, the lamp off? Record it again"
            )
    return StepSummary(f"{float(background.mean.mean()):.2f} grey levels", lines, warnings)


def summarize_flat_field(flat: NDArray[np.float32], draft: Draft, _setup: Setup) -> StepSummary:
    """Summarize a flat field: its unevenness; see :class:`CalibrationStep`."""
    structure = structure_of_flat_field(flat, draft.calibration)
    warnings = [f"{_varies(structure)}: it is not used; take it on an even target"] * (structure > MAX_STRUCTURE)
    return StepSummary(
        f"{100 * unevenness(flat):.1f} % uneven", ["standard deviation in the 90 % disc, cores included"], warnings
    )


def unevenness(flat: NDArray[np.float32]) -> float:
    """Return the standard deviation of a flat field `flat` (n, n) in its 90 % disc, relative to its mean of 1."""
    return float(flat[disc(len(flat), USED_DIAMETER * len(flat))].std())


def _varies(structure: float) -> str:
    return f"the light varies by {100 * structure:.0f} % from place to place, as a specimen's does"
