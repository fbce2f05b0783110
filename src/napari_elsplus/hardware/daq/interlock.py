"""Interlocks of a scan: conditions under which the laser line would stand on the bundle, or sweep it unseen."""

from __future__ import annotations

from math import inf
from typing import TYPE_CHECKING, Final

from napari_elsplus.errors import DeviceError

if TYPE_CHECKING:
    from napari_elsplus.hardware.daq.output import CardSettings
    from napari_elsplus.hardware.scan.waveform import Waveform

LOST_AFTER_FRAMES: Final = 6
LOST_AFTER_S: Final = 0.08
"""Frame periods, and seconds, after which a strobe counts as lost; chosen: above the jitter of this thread."""
SILENCE_S: Final = 0.3
"""Seconds; chosen: with a check, a stop and a write it leaves the galvo parked within 0.5 s."""
NO_FRAMES_S: Final = 1.0
"""Seconds; chosen: above the stalls of a busy computer, since the line sweeps meanwhile and does not stand."""
LOW_RATE_PERIODS: Final = 1.5
"""Frame periods that have to pass at rates so low that they are longer than `SILENCE_S`."""
MAX_STEP_S: Final = 0.05
"""Seconds by which a silence grows from check to check at most, so that a computer that stood still is no silence."""


def silence_limit_s(frame_period_s: float) -> float:
    """Return the seconds without strobe or frame that are a fault, for a frame period.

    Examples
    --------
    >>> [round(silence_limit_s(1 / rate_hz), 3) for rate_hz in (240, 60, 10, 3)]
    [0.08, 0.1, 0.3, 0.5]
    """
    low_rate = max(SILENCE_S, LOW_RATE_PERIODS * frame_period_s)
    return max(LOST_AFTER_S, min(LOST_AFTER_FRAMES * frame_period_s, low_rate))


class Interlock:
    """Compares ramps, frames and time since the galvo was last commanded.

    Parameters
    ----------
    card : CardSettings
        Hold limit, and names for messages.
    """

    def __init__(self, card: CardSettings) -> None:
        self._card = card
        self._waveform: Waveform | None = None
        self._held_since_s = inf

    def rest(self) -> None:
        """Expect nothing: the galvo is parked."""
        self._waveform, self._held_since_s = None, inf

    def hold(self, now_s: float) -> None:
        """Expect the next command within the hold limit from `now_s` on."""
        self._waveform, self._held_since_s = None, now_s

    def scan(self, waveform: Waveform, now_s: float, frames: int | None) -> None:
        """Expect ramps and frames at the rate of a waveform.

        Parameters
        ----------
        waveform : Waveform
            What is put out from now on.
        now_s : float
            Time in seconds.
        frames : int, optional
            Frames received so far; None: they are not counted.
        """
        self._waveform, self._held_since_s = waveform, now_s
        self._samples, self._samples_s = 0, now_s
        self._frames, self._checked_s = frames, now_s
        self._frames_came = False
        self._no_frames_s = self._no_ramps_s = 0.0

    def fault(self, now_s: float, samples: int, frames: int | None) -> DeviceError | None:
        """Return the fault that stops the galvo, None if there is none.

        Parameters
        ----------
        now_s : float
            Time in seconds.
        samples : int
            Samples put out since `scan`.
        frames : int, optional
            Frames received; None: they are not counted.
        """
        if self._waveform is None:
            return self._held_too_long(now_s)
        limit_s = silence_limit_s(self._waveform.frame_period_s)
        step_s = min(max(now_s - self._checked_s, 0.0), MAX_STEP_S)
        self._checked_s = now_s
        if samples != self._samples:
            self._samples, self._samples_s = samples, now_s
        came = frames is not None and frames != self._frames
        self._frames_came |= came
        self._frames = frames
        if not samples:
            self._no_ramps_s += step_s if self._frames_came else 0.0
            if self._no_ramps_s > limit_s and came:
                return self._never_wired()
            return self._held_too_long(now_s)
        late_s = now_s - self._samples_s
        if late_s > limit_s:
            return DeviceError(
                f"no strobe for {late_s * 1e3:.0f} ms, so the galvo was parked",
                f"check that the camera runs and that its strobe reaches {self._card.strobe}",
            )
        self._no_frames_s = 0.0 if came or frames is None else self._no_frames_s + step_s
        if self._no_frames_s > max(NO_FRAMES_S, limit_s):
            return DeviceError(
                f"ramps begin and no frame has come for {self._no_frames_s * 1e3:.0f} ms, so the galvo was parked",
                "check the camera's cable and what else uses its bus",
            )
        return None

    def _never_wired(self) -> DeviceError:
        card = self._card
        return DeviceError(
            f"frames come and no ramp begins: no strobe reaches {card.strobe} of {card.device}; the galvo was parked",
            f"wire the camera's strobe output to {card.strobe}, or correct strobe, strobe_line and falling in the "
            "rig's file",
        )

    def _held_too_long(self, now_s: float) -> DeviceError | None:
        limit_s = self._card.hold_limit_s
        if now_s - self._held_since_s <= limit_s:
            return None
        return DeviceError(
            f"the line stood on one place for {limit_s:g} s, so the galvo was parked",
            "start again; the limit is hold_limit_s in the rig's file",
        )
