"""What is shown of the slit offset while the tilt mirror is being turned: the offset, and what it gives and costs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.instrument.optics import BUNDLE_UM
from napari_elsplus.widgets.calibration.picture import Picture, Plot, told
from napari_elsplus.widgets.shared.plots import Band, Curve
from napari_elsplus.workflows.sectioning_performance import line_as_seen, predict_performance

if TYPE_CHECKING:
    from napari_elsplus.processing.calibration.calibrate import SlitOffset
    from napari_elsplus.processing.calibration.draft import Draft, Setup
    from napari_elsplus.processing.calibration.line import Line

TOLERANCE_UM: Final = 1.0
"""Half the width of the green band around the target."""
_SLIT_ROWS: Final = 3.0
"""Where the setup does not tell it."""
_FIT_WIDTHS: Final = 2.5
"""Standard deviations of the line to which its fit is drawn."""


def offset_picture(found: SlitOffset, draft: Draft, setup: Setup, target_um: float) -> Picture:
    """Say and draw a slit offset.

    Parameters
    ----------
    found : SlitOffset
        What was found.
    draft : Draft
        What was known before.
    setup : Setup
        What it was measured with.
    target_um : float
        Slit offset that is wanted, without its sign.
    """
    scale = draft.um_per_px or setup.um_per_px
    slit_rows = setup.acquired_with.slit_rows or _SLIT_ROWS
    headline, far = f"{told(found.rows, found.uncertainty_rows)} rows", f"{found.rows:.1f} rows"
    lines, warnings, bands, good = [], [], [], None
    radius_px = (BUNDLE_UM / scale if scale else found.left.columns[1] - found.left.columns[0]) / 2
    tilt, spread = found.left.tilt_deg, found.left.tilt_uncertainty_deg
    cost = abs(np.tan(np.radians(tilt))) * radius_px
    lines.append(f"tilt {told(tilt, spread)}°: {cost:.1f} rows at the rim")
    if cost > slit_rows / 2:
        warnings.append(f"the tilt costs more than half the slit of {slit_rows:g} rows: turn the line level")
    if scale is not None:
        offset_um = found.rows * scale
        headline += f"<br>{told(offset_um, found.uncertainty_rows * scale)} µm"
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
    given = predict_performance(
        found.rows * scale, slit_rows * scale, line, light_dn, gain_db=gain_db, bundle_um=draft.bundle_um
    )
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
