"""Settings and status of the engine: plain values that cross processes."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import isfinite, nan
from typing import TYPE_CHECKING, Any

from napari_elsplus.acquisition.engine.live_images import Measures
from napari_elsplus.acquisition.streaming.tally import Latency
from napari_elsplus.hardware.parking import ParkState

if TYPE_CHECKING:
    from collections.abc import Mapping

    from napari_elsplus.acquisition.mosaic.tracking import TrackState
    from napari_elsplus.acquisition.streaming.faults import Fault
    from napari_elsplus.acquisition.streaming.ring import Layout


@dataclass(frozen=True, slots=True)
class Settings:
    """Settings of the rig.

    Parameters
    ----------
    preset : str
        ``"240hz"`` or ``"120hz"``: region and objective.
    slit_rows : int
        Width of the rolling slit, the exposure in line periods.
    frame_rate_hz : float, optional
        By default the preset's, or the highest that camera and bus allow; lower rates keep the line period.
    gain_db : float
        Gain of the camera, dB.
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
        True while frames are added.
    seconds : float
        From its first frame to the end of the last one.
    missing : int
        Frames in between that were lost.
    """

    path: str
    frames: int
    running: bool
    seconds: float = 0.0
    missing: int = 0


@dataclass(frozen=True, slots=True)
class ProcedureProgress:
    """Progress of a procedure.

    Parameters
    ----------
    step : str
        Name of the step.
    done, total : int
        Parts of the step that are done, and all; 0 in all if unknown.

    Examples
    --------
    >>> str(ProcedureProgress("galvo map", 3, 60)), str(ProcedureProgress("preparing", 0, 0))
    ('galvo map, 3 of 60', 'preparing')
    """

    step: str
    done: int
    total: int

    def __str__(self) -> str:
        return f"{self.step}, {self.done} of {self.total}" if self.total else self.step


@dataclass(frozen=True, slots=True)
class Status:
    """The engine at one moment.

    Parameters
    ----------
    configured : bool
        True if the camera has settings; an unconfigured engine does not start.
    notice : str
        Why the default frame rate is lower than the preset's; empty if it is not.
    compiling : str
        Name of the kernel that is being compiled; empty if there is none.
    live : bool
        True while frames stream.
    scanning : bool
        True while the galvo scans.
    park_state : ParkState
        State of parking, with what to do by hand in its message.
    acquired, processed, recorded : int
        Frames of this run.
    dropped : mapping
        Frames lost in this run, by cause.
    camera_hz : float
        Frames per second of the camera at present, by its numbers and clock; NaN if there are none.
    mean_hz : float
        Frames that arrived per second over the run.
    saturated : float
        Mean share of saturated pixels in the displayed frames of the run.
    latency_ms : Latency
        Last byte of a frame to its result.
    cpu_us_per_frame : mapping
        Processor time of each thread of the engine's process in microseconds per frame, once the run has ended.
    started_s : float
        Seconds from the process' creation to the first frame of the run; NaN before it.
    measures : Measures
        Saturation and focus of the newest displayed frame.
    recording : RecordingState, optional
        The newest recording.
    disk_bytes_per_s : float
        Data rate of a recording.
    display : tuple, optional
        Name of the shared memory (empty if on the heap) and layout of the display's ring.
    faults : tuple of Fault
        Oldest first.
    stale : mapping
        Sections of the calibration that are stale, with the reason.
    disagreement : str
        In which way the newest scanned frames contradict the calibration, with the remedy; empty if they do not.
    waiting : str
        Which command has not ended for long, and which waits for it; empty if there is none.
    progress : ProcedureProgress, optional
        Of the procedure that runs.
    track : TrackState, optional
        The live track and mosaic, while there is one.
    """

    configured: bool = False
    notice: str = ""
    compiling: str = ""
    live: bool = False
    scanning: bool = False
    park_state: ParkState = field(default_factory=ParkState)
    acquired: int = 0
    processed: int = 0
    recorded: int = 0
    dropped: Mapping[str, int] = field(default_factory=dict)
    camera_hz: float = nan
    mean_hz: float = nan
    saturated: float = nan
    latency_ms: Latency = field(default_factory=Latency)
    cpu_us_per_frame: Mapping[str, float] = field(default_factory=dict)
    started_s: float = nan
    measures: Measures = field(default_factory=Measures)
    recording: RecordingState | None = None
    disk_bytes_per_s: float = nan
    display: tuple[str, Layout] | None = None
    faults: tuple[Fault, ...] = ()
    stale: Mapping[str, str] = field(default_factory=dict)
    disagreement: str = ""
    waiting: str = ""
    progress: ProcedureProgress | None = None
    track: TrackState | None = None

    def report(self) -> dict[str, Any]:
        """Return the report of `acquire`, its keys as documented there; None where there is no number."""
        latency = {name: _number(getattr(self.latency_ms, name)) for name in ("p50", "p99", "max")}
        return {
            "frames": {
                "acquired": self.acquired,
                "processed": self.processed,
                "recorded": self.recorded,
                "dropped": dict(self.dropped),
            },
            "galvo": {"stage": self.park_state.stage.value, "message": self.park_state.message},
            "camera_hz": _number(self.mean_hz),
            "latency_ms": latency,
            "cpu_us_per_frame": {name: round(us, 1) for name, us in self.cpu_us_per_frame.items()},
            "started_s": _number(self.started_s),
            "faults": [
                {"source": fault.source, "problem": fault.problem, "remedy": fault.remedy} for fault in self.faults
            ],
        }


def _number(value: float) -> float | None:
    return round(value, 4) if isfinite(value) else None
