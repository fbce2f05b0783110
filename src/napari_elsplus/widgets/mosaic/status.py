"""Status text of the Mosaic panel."""

from __future__ import annotations

from math import isfinite, nan
from typing import TYPE_CHECKING

from napari_elsplus.instrument.scanning import lag_advice
from napari_elsplus.processing.analysis.saturation import saturation_note
from napari_elsplus.widgets.live.status import parked_advice
from napari_elsplus.widgets.shared.calibration_state import amber

if TYPE_CHECKING:
    from napari_elsplus.acquisition.engine.status import Status
    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.viewing.mosaic.live import LiveMosaicView
    from napari_elsplus.viewing.mosaic.recorded import StackMosaics


def mosaic_text(shown: StackMosaics | LiveMosaicView, segments: int, covered_px: float) -> str:
    """Return the size of a mosaic and its track as rich text.

    Parameters
    ----------
    shown : StackMosaics or LiveMosaicView
        The mosaic.
    segments : int
        Of its track.
    covered_px : float
        Covered pixels of the mosaic.
    """
    counts = shown.rows.counts
    text = f"<b>{counts['tracked']}</b> of {sum(counts.values())} frames tracked"
    text += f" in {segments} segments" if segments > 1 else ""
    text += "".join(f", {counts[state]} {state}" for state in ("predicted", "lost") if counts[state])
    area_mm2 = covered_px * (shown.scale.um_per_px or nan) ** 2 * 1e-6
    return text + (f"; {area_mm2:.2g} mm\N{SUPERSCRIPT TWO}." if isfinite(area_mm2) else ".")


def track_text(status: Status, calibration: Calibration | None) -> str:
    """Return what else is known of a live mosaic, as rich text that follows :func:`mosaic_text`.

    Parameters
    ----------
    status : Status
        Of the engine.
    calibration : Calibration or None
        The active calibration.
    """
    track = status.track
    if track is None:
        return ""
    text = f" Loop closures: {track.loop_closures}." if track.loop_closures else ""
    if not track.rerenders:
        text += " Not enough memory to re-render: loop closures no longer correct the mosaic."
    if track.running:
        advice = saturation_note(status.measures.saturated), lag_advice(calibration)
        lines = (*(amber(line) for line in advice if line), parked_advice(status, calibration))
        text += "".join(f"<br>{line}" for line in lines if line)
    return text
