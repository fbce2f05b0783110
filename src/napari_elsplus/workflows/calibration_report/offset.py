"""The slit offset as displayed while the tilt mirror is being turned, with the sectioning performance it predicts."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.processing.axial.axial_response import LEVEL_3DB, LEVEL_10DB
from napari_elsplus.simulation.model.axial_response import LineModel, model_response
from napari_elsplus.workflows.calibration_report.picture import Picture, Plot
from napari_elsplus.workflows.pictures.curves import Band, Curve
from napari_elsplus.workflows.recommendation.line_estimate import line_of_parts
from napari_elsplus.workflows.sectioning_performance import line_as_seen, predict_performance

if TYPE_CHECKING:
    from napari_elsplus.processing.calibration.draft import Draft, Setup
    from napari_elsplus.processing.calibration.line.location import Line
    from napari_elsplus.processing.calibration.slit_offset import SlitOffset
    from napari_elsplus.processing.calibration.step import StepSummary

TOLERANCE_UM: Final = 1.0
"""Half the width of the green band around the target; chosen: a thirtieth of the usual offset."""
_OFFSETS_UM: Final = (8.0, 90.0)
"""Slit offsets over which the sectioning is drawn, micrometres; chosen: the paper's are 12 to 77."""
_COMPUTED: Final = 24
"""Offsets at which it is computed; chosen."""
_DEPTHS_UM: Final = np.linspace(0, 400, 201)
"""Depths between which drop-off distances are interpolated, micrometres; chosen: steps of 2."""
_FIT_WIDTHS: Final = 2.5
"""Standard deviations of the line to which its fit is drawn; chosen, the fit's height is then 4 %."""


def offset_picture(
    found: SlitOffset, summary: StepSummary, draft: Draft, setup: Setup, target_um: float | None = None
) -> Picture:
    """Return the picture of a slit offset.

    Parameters
    ----------
    found : SlitOffset
        The offset.
    summary : StepSummary
        Its summary.
    draft : Draft
        Results accepted before.
    setup : Setup
        Settings with which its frames were taken.
    target_um : float, optional
        Wanted slit offset in micrometres, without its sign.
    """
    scale, far, good = draft.um_per_px or setup.um_per_px, f"{found.rows:.1f} rows", None
    lines, bands = list(summary.lines), []
    if scale is not None:
        offset_um = found.rows * scale
        far = f"{offset_um:.1f} µm"
        if target_um is not None:
            good = abs(abs(offset_um) - target_um) <= TOLERANCE_UM
            sign = -1 if found.rows < 0 else 1
            ends = sorted(sign * (target_um + side) / scale for side in (-TOLERANCE_UM, TOLERANCE_UM))
            bands.append(Band(ends[0], ends[1], "green"))
        lines += _predicted_performance(found, draft, setup, scale)
    confocal = _profile("confocal", found.confocal, 0.0, "blue")
    residual = _profile("residual", found.residual, found.rows, "orange")
    plots = [Plot("rows from the confocal line", "grey levels", [*confocal, *residual], bands=bands)]
    if scale is not None and found.rows:
        plots.append(_sectioning_against_offset(found, draft, setup, scale))
    return Picture(summary.headline, lines, summary.warnings, summary.details, plots, good, far)


def _predicted_performance(found: SlitOffset, draft: Draft, setup: Setup, scale: float) -> list[str]:
    if found.rows == 0:
        return ["without an offset ELS+ is zero everywhere"]
    slit_rows = setup.acquired_with.slit_rows_or_default
    line = _line(found, draft, slit_rows, scale)
    light_dn, gain_db = found.confocal.amplitude, setup.acquired_with.gain_db or 0.0
    bundle_um = draft.bundle_um or found.confocal.length_px * scale
    given = predict_performance(
        found.rows * scale, slit_rows * scale, line, light_dn, gain_db=gain_db, bundle_um=bundle_um
    )
    return [
        f"predicted drop-offs {given.drop_3db_um:.0f} µm (3 dB), {given.drop_10db_um:.0f} µm (10 dB)",
        f"signal kept {100 * given.signal_kept:.0f} %, contrast to noise {given.contrast_to_noise:.0f}, "
        f"{100 * given.clipped:.1f} % of the field clipped",
        f"with this line: {line.core_um:.1f} µm wide (SD), {light_dn:.0f} grey levels",
    ]


def _line(found: SlitOffset, draft: Draft, slit_rows: float, scale: float) -> LineModel:
    """Return the line with its core and halo, those calibrated before where this profile does not show both."""
    seen, known = found.parts, draft.calibration.offset
    if seen is not None:
        return line_of_parts(seen.core_rows * scale, seen.halo_rows * scale, seen.halo_share)
    if known is None or known.core_rows is None or known.halo_rows is None or known.halo_share is None:
        return line_as_seen(found.confocal, slit_rows, scale)
    return line_of_parts(known.core_rows * scale, known.halo_rows * scale, known.halo_share)


def _sectioning_against_offset(found: SlitOffset, draft: Draft, setup: Setup, scale: float) -> Plot:
    """Return what ELS+ keeps and how it sections against the slit offset, with the present offset marked."""
    slit_rows = setup.acquired_with.slit_rows_or_default
    line, present_um = _line(found, draft, slit_rows, scale), abs(found.rows) * scale
    offsets = np.linspace(_OFFSETS_UM[0], max(_OFFSETS_UM[1], 1.2 * present_um), _COMPUTED)
    els = model_response(_DEPTHS_UM, offset_um=offsets[:, None], slit_um=slit_rows * scale, line=line).els
    levels = LEVEL_3DB, LEVEL_10DB
    distances = [[np.interp(-level, -curve / curve[0], _DEPTHS_UM) for curve in els] for level in levels]
    curves = [
        Curve("signal kept (%)", offsets, 100 * els[:, 0], "blue"),
        Curve("3 dB (µm)", offsets, np.array(distances[0]), "orange", "dashed"),
        Curve("10 dB (µm)", offsets, np.array(distances[1]), "vermilion"),
    ]
    return Plot("slit offset (µm)", "ELS+ against LS (%), depth (µm)", curves, marks=[(present_um, "grey", "now")])


def _profile(name: str, line: Line, at_rows: float, colour: str) -> list[Curve]:
    rows = line.profile_rows
    near = np.abs(rows) < _FIT_WIDTHS * line.width_rows
    return [
        Curve(name, rows + at_rows, line.profile, colour, "none", marks=True),
        Curve(f"{name} fit", rows[near] + at_rows, line.fitted[near], colour, listed=False),
    ]
