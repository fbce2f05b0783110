"""What the Live panel says of the stream."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from napari_elsplus.acquisition.engine.status import Status
    from napari_elsplus.instrument.calibration import Calibration

SATURATED: Final = 0.001
"""Share of saturated pixels from which the light is said to be too much."""


def advice_on(calibration: Calibration | None) -> str:
    """Say what is missing where a mirror is driven by a calibration without the scan's lag; empty if nothing is.

    Parameters
    ----------
    calibration : Calibration or None
        In force.
    """
    if calibration is None or calibration.galvo is None or calibration.galvo.lag_s != 0:
        return ""
    return "The scan lag was not measured: where images are dim, do step 4 of Calibration."


def said_of(status: Status | None, calibration: Calibration | None, display_hz: float, *, busy: bool) -> str:
    """Say how the stream goes, as rich text.

    Parameters
    ----------
    status : Status or None
        Of the engine, where a rig is connected.
    calibration : Calibration or None
        In force.
    display_hz : float
        Images shown each second.
    busy : bool
        Whether the engine has yet to answer.
    """
    if status is None:
        return "Connecting..." if busy else "Not connected: Start connects to the rig."
    if status.progress is not None:
        return f"Calibrating: {status.progress.step}, {status.progress.done} of {status.progress.total}"
    if not status.live:
        return "Starting..." if busy else "Stopped."
    lost = ", ".join(f"{count} {cause}" for cause, count in status.dropped.items()) or "none"
    lines = [
        f"camera {status.camera_hz:.0f} Hz, display {display_hz:.0f} Hz, latency {status.latency_ms.p50:.1f} ms",
        f"lost: {lost}",
    ]
    if status.recording is not None and status.recording.running:
        left = shutil.disk_usage(Path(status.recording.path).parent).free / status.disk_bytes_per_s / 60
        lines.append(f"<b>recording</b> {status.recording.frames} frames; the disk lasts {left:.0f} minutes")
    measures = status.measures
    lines.append(f"saturated {100 * measures.saturated:.2f} %, focus {measures.focus:.3g}")
    if measures.saturated > SATURATED:
        lines.append("<b>Saturated</b>: lower the light or the gain.")
    lines += [f"stale: {section} ({reason})" for section, reason in status.stale.items()]
    if status.scanning and (advice := advice_on(calibration)):
        lines.append(advice)
    return "<br>".join(lines)
