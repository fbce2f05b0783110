"""The recorder's thread: raw frames from the stream into a file, from before its start until its end."""

from __future__ import annotations

import errno
from contextlib import ExitStack
from dataclasses import dataclass
from math import inf, isfinite, prod
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Any, Final

from napari_elsplus.errors import DeviceError, InputError
from napari_elsplus.hardware.priority import Rank, join_frame_core
from napari_elsplus.instrument.arguments import require_path
from napari_elsplus.io import RecordingWriter, refuse_existing
from napari_elsplus.io.disk import require_room

if TYPE_CHECKING:
    from collections.abc import Mapping

    from napari_elsplus.acquisition.streaming.faults import FaultLog
    from napari_elsplus.acquisition.streaming.ring import Stamp
    from napari_elsplus.acquisition.streaming.stream import FrameStream
    from napari_elsplus.acquisition.streaming.tally import Tally
    from napari_elsplus.instrument.calibration import Calibration

FULL_DISK_ERRORS: Final = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""By which a system tells that a disk, a user's share of it, or a file is full."""
_SLOW: Final = "recorder slow"
"""Cause of lost frames."""
_POLL_S: Final = 0.1
"""Chosen: how long to wait for a frame before the end of the stream is tested."""
_BATCH: Final = 4
"""Frames for which this thread wakes; chosen: 17 ms at 240 Hz, little beside the second that a power cut may cost. With
it, and a lock of its own to wake by, the thread took 0.22 ms a frame instead of 0.35 (medians of three runs)."""


@dataclass(frozen=True, slots=True)
class RecordingPlan:
    """A recording to be made: until stopped, or until one of the limits.

    Parameters
    ----------
    path : path-like
        The file, NAME.ome.tif.
    frames : int, optional
        Stop after this many frames.
    seconds : float, optional
        Stop when the frames span this time.
    earlier_s : float
        Begin this many seconds before the start, as far as the frames are still in memory.
    force : bool
        Replace existing files.

    Raises
    ------
    InputError
        If the path is none, or a limit is not positive.
    """

    path: Path
    frames: int | None = None
    seconds: float | None = None
    earlier_s: float = 0.0
    force: bool = False

    def __post_init__(self) -> None:
        require_path(self.path)
        object.__setattr__(self, "path", Path(self.path))
        for name in ("frames", "seconds"):
            value = getattr(self, name)
            if value is not None and not value > 0:
                raise InputError(f"a recording of {value} {name}", "give a positive number, or none")
        if not self.earlier_s >= 0:
            raise InputError(f"a recording that begins {self.earlier_s} s earlier", "give 0 or a positive number")


class Recorder(Thread):
    """Writes frames from now until a limit, :meth:`stop`, or the end of the stream; the file is closed in every case.

    Parameters
    ----------
    stream : FrameStream
        Where the frames come from.
    plan : RecordingPlan
        File and limits.
    frame_rate_hz : float
        Converts seconds before the start to frames.
    calibration : Calibration, optional
        The active one; written beside the file before the first frame.
    settings : mapping
        The rig's settings, kept in the file.
    tally : Tally
        Counts recorded and lost frames.
    faults : FaultLog
        Receives a full disk, and any other failure.

    Raises
    ------
    InputError
        If the file exists and may not be replaced, or its folder is missing.
    OSError
        If what the plan's limits allow does not fit on the disk.
    """

    def __init__(
        self,
        stream: FrameStream,
        plan: RecordingPlan,
        *,
        frame_rate_hz: float,
        calibration: Calibration | None,
        settings: Mapping[str, Any],
        tally: Tally,
        faults: FaultLog,
    ) -> None:
        super().__init__(name="recorder", daemon=True)
        self.plan = plan
        self._tally, self._faults = tally, faults
        self._lost_before = tally.dropped[_SLOW]  # by earlier recordings of the run
        self._stream = stream
        frames = min(plan.frames or inf, (plan.seconds or inf) * frame_rate_hz)
        if isfinite(frames):
            refuse_existing(plan.path, force=plan.force)
            require_room(plan.path, frames * prod(stream.frame_shape))
        self._period_s = 1 / frame_rate_hz
        self._stop_before: int | None = None
        self._span: tuple[Stamp, Stamp, int] | None = None
        with ExitStack() as held:  # where it is refused or interrupted, nothing stays
            # joined first: frames from before the start leave the memory while a slow disk makes the file
            self._cursor = stream.join(earlier=round(plan.earlier_s * frame_rate_hz), batch=_BATCH)
            held.callback(self._cursor.close)
            self._writer = held.enter_context(
                RecordingWriter(
                    plan.path, stream.frame_shape, "uint8", calibration=calibration, settings=settings, force=plan.force
                )
            )
            held.callback(self._give_up)
            self.start()
            held.pop_all()

    @property
    def frames(self) -> int:
        """Frames in the file so far."""
        return len(self._writer)

    @property
    def seconds(self) -> float:
        """Time from the first frame in the file to the end of the last one, by the camera's clock."""
        if self._span is None:
            return 0.0
        first, last, _ = self._span
        return last.readout_start_s - first.readout_start_s + self._period_s

    @property
    def missing(self) -> int:
        """Frames between the first and the last one in the file that are not in it, by the camera's numbers."""
        if self._span is None:
            return 0
        first, last, frames = self._span
        return last.frame_number - first.frame_number + 1 - frames

    @property
    def full(self) -> bool:
        """True if all frames of the plan are in the file."""
        return self.plan.frames is not None and self.frames >= self.plan.frames

    def stop(self) -> None:
        """End the recording with the newest frame of now."""
        if self._stop_before is None:
            self._stop_before = self._stream.written

    def run(self) -> None:
        """Write until the end; then complete the file."""
        join_frame_core(Rank.REST)
        try:
            try:
                self._write()
            finally:
                self._writer.close()
        except OSError as error:
            problem = f"{self.plan.path.name}: {error.strerror or error}"
            self._faults.add("recorder", DeviceError(problem, _remedy(error, self.plan.path)))
        except Exception as error:  # noqa: BLE001 - never silently dead
            self._faults.add("recorder", error)
        finally:
            self._cursor.close()

    def _give_up(self) -> None:
        """Write no frame any more; returns when the thread has ended, if it had begun."""
        self._stop_before = 0
        if self.is_alive():
            self.join()

    def _write(self) -> None:
        while not self.full:
            taken = self._cursor.take(_POLL_S)
            if taken is None:
                if self._stream.ended or self._beyond_end(self._cursor.next):
                    return
                continue
            frame, stamp = taken
            if self._beyond_end(stamp.sequence):
                return
            first = stamp if self._span is None else self._span[0]
            if (
                self.plan.seconds is not None
                and stamp.readout_start_s - first.readout_start_s > self.plan.seconds - 0.5 * self._period_s
            ):
                return
            self._writer.append(frame, stamp.readout_start_s, stamp.frame_number)
            self._span = first, stamp, len(self._writer)
            self._tally.recorded += 1
            self._tally.skipped(_SLOW, self._lost_before + self._cursor.skipped)

    def _beyond_end(self, sequence: int) -> bool:
        """Return True if the frame of a sequence number came after :meth:`stop`."""
        return self._stop_before is not None and sequence >= self._stop_before


def _remedy(error: OSError, path: Path) -> str:
    """Return what the user can do about an error of the disk that has ended a recording."""
    if not path.exists():
        return f"{path} was removed or its disk taken away, and with it what was recorded: record it again"
    what = "free some disk space" if error.errno in FULL_DISK_ERRORS else "test the disk, or record to another"
    return f"{what}; what was written is readable"
