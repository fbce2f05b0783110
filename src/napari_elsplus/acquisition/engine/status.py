"""What the engine says of itself, a few times a second: plain values that cross processes."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import isfinite, nan
from typing import TYPE_CHECKING, Any

from napari_elsplus.acquisition.engine.live_images import Measures
from napari_elsplus.acquisition.streaming.tally import Latency

if TYPE_CHECKING:
    from collections.abc import Mapping

    from napari_elsplus.acquisition.mosaic.tracking import TrackState
    from napari_elsplus.acquisition.streaming.faults import Fault
    from napari_elsplus.acquisition.streaming.ring import Layout


@dataclass(frozen=True, slots=True)
class Settings:
    """How the rig runs.

    Parameters
    ----------
    preset : str
        ``"240hz"`` or ``"120hz"``: region and objective.
    slit_rows : int
        Width of the rolling slit, the exposure in line periods.
    frame_rate_hz : float, optional
        The preset's highest rate by default; lower rates keep the line period.
    gain_db : float
        Of the camera.
    """

    preset: str = "240hz"
    slit_rows: int = 3
    frame_rate_hz: float | None = None
    gain_db: float = 0.0


@dataclass(frozen=True, slots=True)
class RecordingState:
    """A recording in progress, or the last one that ended.

    Parameters
    ----------
    path : str
        The file.
    frames : int
        Frames in it.
    running : bool
        Whether it still grows.
    """

    path: str
    frames: int
    running: bool


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a procedure is.

    Parameters
    ----------
    step : str
        What is done.
    done, total : int
        Of the step's parts.
    """

    step: str
    done: int
    total: int


@dataclass(frozen=True, slots=True)
class Status:
    """The engine at one moment.

    Parameters
    ----------
    live : bool
        Whether frames stream.
    scanning : bool
        Whether the mirror scans.
    acquired, processed, recorded : int
        Frames of this run.
    dropped : mapping
        Frames lost in this run, by cause.
    camera_hz : float
        Frames per second, lately; NaN if none.
    mean_hz : float
        Frames per second over the run.
    latency_ms : Latency
        Last byte of a frame to its result.
    measures : Measures
        Saturation and focus of the newest frame shown.
    recording : RecordingState, optional
        The newest recording.
    disk_bytes_per_s : float
        What recording costs at this rate.
    display : tuple, optional
        Name of the shared memory (empty if on the heap) and layout of the ring that shows images.
    faults : tuple of Fault
        What went wrong, oldest first.
    stale : mapping
        Sections of the calibration that do not hold any more, with the reason.
    progress : Progress, optional
        Of the procedure that runs.
    track : TrackState, optional
        The live track and mosaic, while there is one.
    """

    live: bool = False
    scanning: bool = False
    acquired: int = 0
    processed: int = 0
    recorded: int = 0
    dropped: Mapping[str, int] = field(default_factory=dict)
    camera_hz: float = nan
    mean_hz: float = nan
    latency_ms: Latency = field(default_factory=Latency)
    measures: Measures = field(default_factory=Measures)
    recording: RecordingState | None = None
    disk_bytes_per_s: float = nan
    display: tuple[str, Layout] | None = None
    faults: tuple[Fault, ...] = ()
    stale: Mapping[str, str] = field(default_factory=dict)
    progress: Progress | None = None
    track: TrackState | None = None

    def report(self) -> dict[str, Any]:
        """Return the content of `acquire`'s report: frames, rate, latencies, faults; null where there is no number."""
        latency = {name: _number(getattr(self.latency_ms, name)) for name in ("p50", "p99", "max")}
        return {
            "frames": {
                "acquired": self.acquired,
                "processed": self.processed,
                "recorded": self.recorded,
                "dropped": dict(self.dropped),
            },
            "camera_hz": _number(self.mean_hz),
            "latency_ms": latency,
            "faults": [
                {"source": fault.source, "problem": fault.problem, "remedy": fault.remedy} for fault in self.faults
            ],
        }


def _number(value: float) -> float | None:
    return round(value, 4) if isfinite(value) else None
