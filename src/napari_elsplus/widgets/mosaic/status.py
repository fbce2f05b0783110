"""Status text of the Mosaic panel."""

from __future__ import annotations

from math import isfinite, nan
from typing import TYPE_CHECKING

from napari_elsplus.instrument.scanning import lag_advice
from napari_elsplus.processing.analysis.saturation import saturation_note
from napari_elsplus.viewing.mosaic.live import LiveMosaicView
from napari_elsplus.widgets.live.status import parked_advice
from napari_elsplus.widgets.shared.calibration_state import amber
from napari_elsplus.widgets.shared.panel import next_hint

if TYPE_CHECKING:
    from napari_elsplus.acquisition.engine.status import Status
    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.viewing.mosaic.recorded import StackMosaics


def mosaic_text(shown: StackMosaics | LiveMosaicView, segments: int, covered_px: float, *, busy: bool = False) -> str:
    """Return the size of a mosaic and its track as rich text.

    Parameters
    ----------
    shown : StackMosaics or LiveMosaicView
        The mosaic.
    segments : int
        Of its track.
    covered_px : float
        Covered pixels of the mosaic.
    busy : bool
        It is still being made, or saved.
    """
    counts = shown.rows.counts
    text = f"<b>{counts['tracked']}</b> of {sum(counts.values())} frames tracked"
    text += f" in {segments} segments" if segments > 1 else ""
    text += "".join(f", {counts[state]} {state}" for state in ("predicted", "lost") if counts[state])
    area_mm2 = covered_px * (shown.scale.um_per_px or nan) ** 2 * 1e-6
    text += f"; {area_mm2:.2g} mm\N{SUPERSCRIPT TWO}." if isfinite(area_mm2) else "."
    return text if busy else text + stopped_text(shown)


def stopped_text(shown: StackMosaics | LiveMosaicView) -> str:
    """Return in amber that a mosaic of a stack was stopped before its end, and where; empty for others.

    Parameters
    ----------
    shown : StackMosaics or LiveMosaicView
        A mosaic that nothing is added to any more.
    """
    if isinstance(shown, LiveMosaicView) or shown.complete:
        return ""
    left = f"{shown.untracked} images are left" if shown.untracked else "loops are not closed"
    return f"<br>{amber('stopped before the end')}: {left}. {next_hint('press Mosaic to make all of it.')}"


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
