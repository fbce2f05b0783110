"""Checks of the first hour with light: phase of the strobe, and response of the galvo to a step.

The probe is on an evenly fluorescent target, and the calibration has the galvo's map and the bundle.
"""

from __future__ import annotations

import time
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Self

import numpy as np

from napari_elsplus.acquisition.calibrating.simulated import place_target
from napari_elsplus.errors import InputError, MeasurementError
from napari_elsplus.hardware.limits import allowed_rate_hz, preset_region
from napari_elsplus.hardware.protocols import Camera, FrameInfo, HasClock
from napari_elsplus.hardware.rigs import open_rig
from napari_elsplus.hardware.scan.timing import ScanTiming, StrobePhase
from napari_elsplus.hardware.scan.waveform import REARM_S, SAMPLE_RATE_HZ, Waveform, els_waveform
from napari_elsplus.instrument.optics import preset
from napari_elsplus.io import read_calibration
from napari_elsplus.processing.calibration.scan.lag import measure_lag
from napari_elsplus.processing.calibration.scan.learned_ramp import shifted
from napari_elsplus.processing.calibration.scan.row_errors import RowProfile
from napari_elsplus.processing.calibration.step import Target

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from numpy.typing import NDArray

    from napari_elsplus.hardware.rig import Rig
    from napari_elsplus.instrument.calibration import Calibration

    Floats = NDArray[np.float64]

PHASE_SLITS: Final = (3, 13)
"""Slit widths in rows between which the phase of the strobe is compared; chosen: 10 rows are 76 us, far above the
uncertainty of a lag."""
PHASE_TOLERANCE_ROWS: Final = 2.0
"""Line periods within which a difference of lags is 0 or that of the slits; chosen: a fifth of the difference."""
FRAMES: Final = 3
"""Frames averaged for each scan; chosen."""
STEP_SHARE: Final = 0.1
"""Height of the galvo's step over the bundle's diameter; chosen: the slit passes it in less time than a galvo takes."""
STEP_TIMES_S: Final = np.concatenate([np.arange(-50e-6, 1.25e-3, 40e-6), np.arange(1.3e-3, 2.6e-3, 100e-6)])
"""Times from the step until the slit is on its beginning, in seconds; chosen: fine while a galvo of 1 kHz moves."""
SETTLED_ROWS: Final = 1.0
"""Distance from the end of the step within which the galvo has settled, in rows; chosen: a third of the slit."""
_SKIPPED_PERIODS: Final = 2.0
"""Frame periods after a new scan whose frames are not used: the line is at rest until the first strobe; chosen."""


def configure(camera: Camera, preset_name: str, slit_rows: int) -> float:
    """Set a camera to a preset at the highest rate that it takes, and return that rate in hertz.

    Parameters
    ----------
    camera : Camera
        Open, and not streaming.
    preset_name : str
        Region and frame rate.
    slit_rows : int
        Slit width in rows.
    """
    chosen = preset(preset_name)
    region = preset_region(camera, chosen)
    rate_hz = allowed_rate_hz(camera, region, slit_rows, chosen.optics.frame_rate_hz)
    camera.configure(region, slit_rows=slit_rows, frame_rate_hz=rate_hz)
    return rate_hz


@contextmanager
def lit_rig(name: str, file: Path | None, preset_name: str) -> Iterator[tuple[Rig, Calibration]]:
    """Open a rig with its calibration; the simulated one with its true calibration and an even target.

    Parameters
    ----------
    name : str
        Name of the rig.
    file : Path, optional
        Its calibration.
    preset_name : str
        Camera mode of the simulated rig's calibration.

    Raises
    ------
    InputError
        If a real rig has no calibration.
    """
    with open_rig(name) as rig:
        place_target(rig, Target.FLUORESCENT)
        if file is not None:
            yield rig, read_calibration(file)
        elif rig.bench is not None:
            yield rig, rig.bench.optics.calibration(preset(preset_name))
        else:
            raise InputError(f"the rig {name} needs a calibration for this check", "give one with -c")


class ScannedFrames:
    """Row profiles of a rig that streams, by one scan after another. A context manager: leaving it parks the galvo.

    Parameters
    ----------
    rig : Rig
        Open, and not streaming.
    calibration : Calibration
        With galvo and bundle.
    preset_name : str
        Region and frame rate.
    slit_rows : int
        Slit width in rows.
    """

    def __init__(self, rig: Rig, calibration: Calibration, preset_name: str, slit_rows: int) -> None:
        self._rig, camera = rig, rig.camera
        configure(camera, preset_name, slit_rows)
        self.timing = ScanTiming(camera.line_period_s, camera.line_periods_per_frame, slit_rows, rig.strobe)
        self.profile = RowProfile(calibration.measured_bundle, camera.frame_shape)
        self._buffer = np.empty(camera.frame_shape, np.uint8)

    def __enter__(self) -> Self:
        self._rig.camera.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._rig.scanner.park()
        self._rig.camera.stop()

    def profiles(self, waveform: Waveform | None) -> Floats:
        """Return the mean row profiles of both views, shape (2, rows), by a scan.

        Parameters
        ----------
        waveform : Waveform, optional
            None: the line parked.
        """
        scanner = self._rig.scanner
        if waveform is None:
            scanner.park()
        else:
            self._rig.check_guarded()
            scanner.scan(waveform)
        after_s = time.perf_counter() + _SKIPPED_PERIODS * self.timing.frame_period_s
        frames: list[NDArray[np.uint8]] = []
        while len(frames) < FRAMES:
            if self._exposed_s(self._rig.camera.read_into(self._buffer, 5.0)) > after_s:
                frames.append(self._buffer.copy())
        scanner.check()
        return self.profile(np.stack(frames))

    def _exposed_s(self, info: FrameInfo) -> float:
        """Return when a frame was exposed at the earliest, on the clock of ``time.perf_counter``."""
        camera = self._rig.camera
        zero_s = camera.clock_zero_s if isinstance(camera, HasClock) else None
        if zero_s is None:
            return info.received_s - self.timing.frame_period_s
        return info.readout_start_s + zero_s - self.timing.slit_rows * self.timing.line_period_s


def strobe_phase(rig: Rig, calibration: Calibration, preset_name: str) -> Iterator[str]:
    """Measure the scan lag with two exposures, and report which event the camera's strobe marks.

    Parameters
    ----------
    rig : Rig
        Open rig, an evenly fluorescent target before its probe.
    calibration : Calibration
        With galvo and bundle.
    preset_name : str
        Region and frame rate.

    Yields
    ------
    str
        One finding each.

    Raises
    ------
    MeasurementError
        If the signal has no maximum within the leads.
    DeviceError
        If camera or card fail.
    """
    calibration.require("galvo", "bundle")
    calibration = calibration.with_galvo(natural_hz=None, damping=None).model_copy(update={"scan_correction": None})
    lags = []
    for slit_rows in PHASE_SLITS:
        with ScannedFrames(rig, calibration, preset_name, slit_rows) as scanned:
            lags.append(measure_lag(_signal(scanned, rig, calibration), scanned.timing.line_period_s))
        yield f"slit of {slit_rows} rows: lag {lags[-1].lag_s * 1e6:.1f} us +- {lags[-1].uncertainty_s * 1e6:.1f} us"
    rows = (lags[1].lag_s - lags[0].lag_s) / scanned.timing.line_period_s
    sigma = np.hypot(lags[0].uncertainty_s, lags[1].uncertainty_s) / scanned.timing.line_period_s
    more = PHASE_SLITS[1] - PHASE_SLITS[0]
    yield f"difference {rows:+.2f} line periods +- {sigma:.2f} for {more} rows of exposure more"
    other, expected = (
        (StrobePhase.READOUT, more) if rig.strobe is StrobePhase.EXPOSURE else (StrobePhase.EXPOSURE, -more)
    )
    if abs(rows) < PHASE_TOLERANCE_ROWS:
        yield f'strobe = "{rig.strobe.value}" is right'
    elif abs(rows - expected) < PHASE_TOLERANCE_ROWS:
        yield f'the strobe marks the {other.value}: write strobe = "{other.value}" into the rig\'s file'
    else:
        yield "the strobe's delay follows the exposure: report it, and recalibrate after every change of the slit"


def _signal(scanned: ScannedFrames, rig: Rig, calibration: Calibration) -> Callable[[float, float], float]:
    """Return what scans with a lead in seconds and a shift in rows, and returns the mean confocal grey level."""
    lit = scanned.profile.lit[0]

    def signal_at(lead_s: float, shift_rows: float) -> float:
        trial = shifted(calibration.with_galvo(lag_s=lead_s), shift_rows)
        return float(scanned.profiles(els_waveform(trial, scanned.timing, rig.limits))[0, lit].mean())

    return signal_at


@dataclass(frozen=True, slots=True)
class StepResponse:
    """Response of the galvo to a step of its drive.

    Parameters
    ----------
    times_s : numpy.ndarray
        Seconds after the step, increasing, shape (n,).
    moved : numpy.ndarray
        Part of the step that the line has moved by then, shape (n,).
    step_rows : float
        Height of the step.
    """

    times_s: Floats
    moved: Floats
    step_rows: float

    def reached_s(self, part: float) -> float:
        """Return when the line has first moved by a part of the step, in seconds after it."""
        index = int(np.argmax(self.moved >= part))
        if index == 0:
            raise MeasurementError(f"the line was not seen to pass {part:.0%} of its step", "raise the light")
        pair = slice(index - 1, index + 1)
        return float(np.interp(part, self.moved[pair], self.times_s[pair]))

    @property
    def overshoot(self) -> float:
        """Part of the step by which the line goes beyond its end."""
        return float(self.moved.max() - 1)

    @property
    def settled_s(self) -> float:
        """Time after which the line stays within `SETTLED_ROWS` of its end, in seconds after the step."""
        away = np.flatnonzero(np.abs(self.moved - 1) * self.step_rows > SETTLED_ROWS)
        return float(self.times_s[min(away[-1] + 1, len(self.times_s) - 1)]) if len(away) else 0.0


def measure_step(rig: Rig, calibration: Calibration, preset_name: str) -> StepResponse:
    """Measure the response of the galvo to a step against the motion of the slit, one instant in each scan.

    Slit and line move towards each other, so that they meet once in a frame; where they meet is the line's row at
    that time. The step's time is varied from scan to scan.

    Parameters
    ----------
    rig : Rig
        Open rig, an evenly fluorescent target before its probe.
    calibration : Calibration
        With galvo and bundle.
    preset_name : str
        Region and frame rate.

    Raises
    ------
    MeasurementError
        If the line is not seen.
    DeviceError
        If camera or card fail.
    """
    galvo, bundle = calibration.measured_galvo, calibration.measured_bundle
    step_rows = STEP_SHARE * bundle.diameter_px
    end_row = bundle.confocal_centre[0] - step_rows / 2
    with ScannedFrames(rig, calibration, preset_name, PHASE_SLITS[0]) as scanned:
        timing = scanned.timing
        samples = min(int((timing.frame_period_s - REARM_S) * SAMPLE_RATE_HZ), rig.limits.card_samples)
        dark = scanned.profiles(None)[0]
        times_s, rows = [], []
        for after_s in STEP_TIMES_S:
            step_s = timing.time_s(end_row + step_rows) - after_s
            stepped = np.arange(samples) / SAMPLE_RATE_HZ >= step_s
            volts = np.where(stepped, galvo.volts(end_row), galvo.volts(end_row + step_rows))
            waveform = Waveform(volts, 1, SAMPLE_RATE_HZ, timing.frame_period_s)
            row = _brightest_row(scanned.profiles(waveform)[0] - dark)
            first_s = float(np.argmax(stepped)) / SAMPLE_RATE_HZ
            times_s.append(timing.time_s(row) - first_s)
            rows.append(row)
    order = np.argsort(times_s)
    moved = (end_row + step_rows - np.array(rows)[order]) / step_rows
    return StepResponse(np.array(times_s)[order], moved, step_rows)


def mirror_step(rig: Rig, calibration: Calibration, preset_name: str) -> Iterator[str]:
    """Report the response of the galvo to a step.

    Parameters
    ----------
    rig, calibration, preset_name
        As in :func:`measure_step`, whose errors it raises, too.

    Yields
    ------
    str
        One finding each.
    """
    response = measure_step(rig, calibration, preset_name)
    begin_s, half_s, end_s = (response.reached_s(part) for part in (0.1, 0.5, 0.9))
    yield f"step of {response.step_rows:.0f} rows: half of it after {half_s * 1e6:.0f} us"
    yield f"from 10 % to 90 % in {(end_s - begin_s) * 1e6:.0f} us, overshoot {response.overshoot:.1%}"
    yield f"within {SETTLED_ROWS:g} row of its end after {response.settled_s * 1e6:.0f} us"
    for time_s, moved in zip(response.times_s, response.moved, strict=True):
        yield f"{time_s * 1e6:7.0f} us {moved:7.3f}"


def _brightest_row(profile: Floats) -> float:
    """Return the middle of the rows that are brighter than half of the brightest, weighted by their light."""
    top = int(np.argmax(profile))
    reach = np.arange(max(0, top - 8), min(len(profile), top + 9))
    light = np.maximum(profile[reach] - profile[top] / 2, 0)
    if not light.sum() > 0:
        raise MeasurementError("the line was not seen", "is the laser on, and the target fluorescent?")
    return float((reach * light).sum() / light.sum())
