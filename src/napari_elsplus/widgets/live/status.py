"""Status text of the Live panel."""

from __future__ import annotations

import shutil
from contextlib import suppress
from html import escape
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING

from napari_elsplus.processing.analysis.saturation import saturation_note
from napari_elsplus.widgets.shared.calibration_state import amber, calibration_lines
from napari_elsplus.widgets.shared.panel import next_hint

if TYPE_CHECKING:
    from napari_elsplus.acquisition.engine.status import Status
    from napari_elsplus.instrument.calibration import Calibration


def status_text(
    status: Status | None,
    calibration: Calibration | None,
    display_hz: float,
    *,
    busy: bool,
    calibration_file: Path | None = None,
) -> str:
    """Return the state of the stream as rich text.

    Parameters
    ----------
    status : Status or None
        Status of the engine; None if no rig is connected.
    calibration : Calibration or None
        The active calibration.
    display_hz : float
        Displayed images per second.
    busy : bool
        A request to the engine is outstanding.
    calibration_file : pathlib.Path, optional
        File of the active calibration.
    """
    if status is None:
        return "Connecting..." if busy else next_hint("press Start; it connects to the rig.")
    if status.progress is not None:
        return f"Calibrating: {status.progress}"
    waiting = [amber(escape(status.waiting))] if status.waiting else []
    if not status.live:
        begun = ["Starting..." if busy else f"Stopped. {next_hint('press Start.')}", *waiting, *_recorded(status)]
        return "<br>".join([*begun, *calibration_lines(calibration, calibration_file)])
    lost = ", ".join(f"{count} ({cause})" for cause, count in status.dropped.items()) or "none"
    lines = [
        *waiting,
        f"camera {_known(status.camera_hz, 0)} Hz, display {display_hz:.0f} Hz, "
        f"latency {_known(status.latency_ms.p50, 1)} ms",
        f"lost: {lost}",
    ]
    measures = status.measures
    if saturated := saturation_note(measures.saturated):
        lines.append(amber(saturated))
    if parked := parked_advice(status, calibration):
        lines.append(parked)
    lines += _recorded(status)
    sharpness = f", sharpness (relative) {measures.focus:.3g}" if isfinite(measures.focus) else ""  # none of the dark
    lines.append(f"saturated {100 * measures.saturated:.2f} %{sharpness}")
    lines += stale_lines(status)
    lines += calibration_lines(calibration, calibration_file)
    return "<br>".join(lines)


def _known(value: float, decimals: int) -> str:
    """Return a number as text, dots before there is one."""
    return f"{value:.{decimals}f}" if isfinite(value) else "..."


def stale_lines(status: Status) -> list[str]:
    """Return lines of rich text: which parts of the calibration no longer hold, why, and what to do.

    Parameters
    ----------
    status : Status
        Of the engine.
    """
    lines = [f"stale: {section} ({reason})" for section, reason in status.stale.items()]
    return [*lines, "Set it back, or measure again in Calibration."] if lines else []


def parked_advice(status: Status, calibration: Calibration | None) -> str:
    """Return that frames are dark because the galvo is parked, and what to do, as rich text; empty if it is not so.

    Parameters
    ----------
    status : Status
        Of the engine.
    calibration : Calibration or None
        The active calibration.
    """
    if not (status.live and status.park_state.parked):
        return ""
    scanned = calibration is not None and calibration.galvo is not None
    remedy = "press Stop, then Start, in Live." if scanned else "calibrate, or load a calibration."
    return f"{amber('the galvo is parked: frames are dark')} {next_hint(remedy)}"


def _recorded(status: Status) -> list[str]:
    """Return what is known of the newest recording: its size, folder, losses, and whether the file is still there.

    While it runs, the disk space that is left, too.
    """
    recording = status.recording
    if recording is None:
        return []
    path, running = Path(recording.path), recording.running
    plural = "" if recording.frames == 1 else "s"
    parts = [f"{path.name}: {recording.frames} frame{plural}", f"{recording.seconds:.1f} s"]
    if recording.missing:
        parts.append(amber(f"{recording.missing} frames lost"))
    lost = ""
    try:
        parts.append(f"{path.stat().st_size / 1e6:.0f} MB")
    except FileNotFoundError:
        remedy = "press Stop recording, and record it again" if running else "put it back, or record it again"
        lost = f"; {amber('the file is no longer there')}: {remedy}"
    except OSError:  # it may be there: a drive that does not answer
        pass
    line = f"<b>{'recording' if running else 'recorded'}</b> {', '.join(parts)}, in {escape(str(path.parent))}{lost}"
    if running:
        with suppress(OSError):
            left = shutil.disk_usage(path.parent).free / status.disk_bytes_per_s / 60
            line += f"; {left:.0f} min of disk space left"
    return [line]
