"""The galvo's drive over one frame: a ramp while anything is exposed, a smooth flyback while nothing is.

Row r is read at t0 + r T and exposed over the E = N T before, so the slit's centre is at row(t) = (t - t0 + E/2) / T;
the line has to be there from the first exposed row of either image to the last. The rest of the frame period,
``line_periods_per_frame - (diameter + |offset_rows| + slit_rows)`` line periods, is available for the flyback. The
drive leads the galvo by its lag; where the galvo's resonance is given, the drive also compensates its response, so
that the line is on the slit from the first row on.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, floor, isfinite, pi, sqrt
from typing import TYPE_CHECKING, ClassVar, Final

import numpy as np

from napari_elsplus.errors import InputError
from napari_elsplus.hardware.scan.path import LEAD_IN_S, TURN_S, PathCorrection, ScanPath
from napari_elsplus.processing.images.modes import FRAMES_PER_IMAGE, elsa_frames

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.hardware.scan.timing import ScanTiming
    from napari_elsplus.instrument.calibration import BundleSection, Calibration, GalvoSection

    Volts = NDArray[np.float64]

SAMPLE_RATE_HZ: Final = 250_000.0
"""Hz; analog output rate of the authors' card."""
MIN_SAMPLE_RATE_HZ: Final = 20_000.0
"""Hz; chosen: 20 steps of the output per period of a 1 kHz galvo, whose response smooths them."""
REARM_S: Final = 16e-6
"""Seconds before a strobe in which the counter cannot be triggered (chosen: 4 samples); the last sample is held."""
BRIDGE_SAMPLES: Final = 24
"""Samples changed before the hold; chosen: six times the hold, so that each changes little."""


@dataclass(frozen=True, slots=True)
class GalvoLimits:
    """Limits of galvo and card, table ``mirror`` of a rig file; drives beyond them are refused before they are put out.

    Parameters
    ----------
    min_v, max_v : float
        Range of the drive in volts.
    max_slew_v_per_s, max_acceleration_v_per_s2 : float
        Of the galvo's motion, in drive volts.
    card_samples : int
        Samples that the card stores and regenerates by itself.
    natural_hz : float, optional
        Resonance of the galvo (small angle); None: only its lag is compensated.
    damping : float
        Damping ratio of that resonance.
    """

    __pydantic_config__: ClassVar = {"extra": "forbid"}  # for a rig file, where an unknown key is a misspelling

    min_v: float = -2.0
    max_v: float = 2.0
    max_slew_v_per_s: float = 1.0e4
    max_acceleration_v_per_s2: float = 5.0e7
    card_samples: int = 8191
    natural_hz: float | None = None
    damping: float = 0.7

    def __post_init__(self) -> None:
        if not self.min_v < self.max_v:
            raise InputError(
                f"min_v {self.min_v:g} is not below max_v {self.max_v:g}", "give a lower and a higher voltage"
            )
        if not -10 <= self.min_v < self.max_v <= 10:
            raise InputError(
                f"the galvo's range is {self.min_v:g} to {self.max_v:g} V", "give min_v and max_v within 10 V"
            )
        for name in ("max_slew_v_per_s", "max_acceleration_v_per_s2", "card_samples", "natural_hz", "damping"):
            value = getattr(self, name)
            if value is not None and not (isfinite(value) and value > 0):
                raise InputError(f"{name} is {value:g}", "give a positive number")

    def check(self, volts: float | Volts, what: str = "the galvo") -> None:
        """Refuse voltages outside the range.

        Parameters
        ----------
        volts : float or numpy.ndarray
            Drive in volts.
        what : str
            Subject of the message.

        Raises
        ------
        InputError
            With the worst voltage.
        """
        low, high = float(np.min(volts)), float(np.max(volts))
        if not (low >= self.min_v and high <= self.max_v):
            worst = high if high > self.max_v else low
            raise InputError(
                f"{worst:.4g} V for {what}",
                f"the rig's limits are {self.min_v:g} to {self.max_v:g} V: check the calibration, or the rig's file",
            )


@dataclass(frozen=True, slots=True)
class Waveform:
    """Samples that the card regenerates: one ramp after each strobe.

    Parameters
    ----------
    volts : numpy.ndarray
        Samples of all ramps, one after the other.
    ramps : int
        1: the same ramp in every frame; 2: ELSA's confocal and residual ramp in turn.
    sample_rate_hz : float
        Samples per second.
    frame_period_s : float
        Seconds between strobes for which it was made.
    exposed_v : tuple of float, optional
        Lowest and highest position of the line in volts while anything is exposed.
    """

    volts: Volts
    ramps: int
    sample_rate_hz: float
    frame_period_s: float
    exposed_v: tuple[float, float] | None = None

    @property
    def samples_per_ramp(self) -> int:
        """Number of samples after one strobe."""
        return len(self.volts) // self.ramps


def exposed_rows(bundle: BundleSection, *, residual: bool = True) -> tuple[float, float]:
    """Return the first and last row of both bundle images, without `residual` of the confocal one alone."""
    centres = [bundle.confocal_centre[0]] + ([bundle.residual_centre[0]] if residual else [])
    radius = bundle.diameter_px / 2
    return min(centres) - radius, max(centres) + radius


def els_waveform(calibration: Calibration, timing: ScanTiming, limits: GalvoLimits) -> Waveform:
    """Build the ramp for ELS+: every frame holds the confocal and the residual image.

    Parameters
    ----------
    calibration : Calibration
        With galvo and bundle sections.
    timing : ScanTiming
        From the camera.
    limits : GalvoLimits
        From the rig.

    Raises
    ------
    CalibrationError
        If the galvo or the bundle was not measured.
    InputError
        If the flyback does not fit the time in which neither image is exposed; the message contains the time that is
        missing, and the offset or frame rate that would fit.

    Examples
    --------
    >>> from napari_elsplus.hardware.scan.timing import ScanTiming
    >>> from napari_elsplus.instrument.calibration import Calibration
    >>> bundle = {"diameter_px": 650, "confocal_centre": [540, 330], "residual_centre": [510, 990],
    ...           "residual_to_confocal": [[1, 0, 30], [0, 1, -660]]}
    >>> galvo = {"volts_per_row": 0.00126, "volts_at_row_zero": -0.459, "r_squared": 1, "rms_rows": 0, "lag_s": 2e-4}
    >>> waveform = els_waveform(
    ...     Calibration.parse({"bundle": bundle, "galvo": galvo}),
    ...     ScanTiming(7.648e-6, 1089.6, slit_rows=3),
    ...     GalvoLimits(),
    ... )
    >>> waveform.samples_per_ramp
    2079
    """
    galvo, bundle = calibration.measured_galvo, calibration.measured_bundle
    rows = exposed_rows(bundle)
    _refuse_without_time(galvo, rows[1] - rows[0], bundle.offset_rows, timing, limits)
    return ramp_waveform(galvo, rows, timing, limits, correction=calibration.scan_correction)


def elsa_waveform(calibration: Calibration, timing: ScanTiming, limits: GalvoLimits) -> Waveform:
    """Build ELSA's two ramps on the confocal image: line on the slit, then `offset_rows` away, in successive frames.

    Parameters
    ----------
    calibration : Calibration
        With galvo, bundle and offset sections.
    timing : ScanTiming
        From the camera.
    limits : GalvoLimits
        From the rig.

    Raises
    ------
    CalibrationError
        If galvo, bundle or offset was not measured.
    InputError
        If the flyback does not fit.
    """
    galvo, bundle, offset = calibration.measured_galvo, calibration.measured_bundle, calibration.measured_offset
    rows = exposed_rows(bundle, residual=False)
    shifts_rows = [0.0] * FRAMES_PER_IMAGE
    shifts_rows[elsa_frames(0)[1]] = offset.rows
    return ramp_waveform(galvo, rows, timing, limits, tuple(shifts_rows), calibration.scan_correction)


def ramp_waveform(
    galvo: GalvoSection,
    rows: tuple[float, float],
    timing: ScanTiming,
    limits: GalvoLimits,
    shifts_rows: tuple[float, ...] = (0.0,),
    correction: NDArray[np.floating] | None = None,
) -> Waveform:
    """Build ramps over given rows: the line on the slit, shifted by a number of rows, one ramp per shift.

    Parameters
    ----------
    galvo : GalvoSection
        Volts per row, volts at row 0, lag, and the resonance if it was measured; else that of the limits is used.
    rows : tuple of float
        First and last exposed row.
    timing : ScanTiming
        From the camera.
    limits : GalvoLimits
        From the rig.
    shifts_rows : tuple of float
        One shift per ramp.
    correction : numpy.ndarray, optional
        Rows added to the path at each row of the frame, shape (rows,).

    Raises
    ------
    InputError
        If slew, acceleration or voltage would leave the limits, or the card's memory is too small.
    """
    period, count = timing.frame_period_s, len(shifts_rows)
    rate = min(SAMPLE_RATE_HZ, limits.card_samples / (count * (period - REARM_S)))
    if rate < MIN_SAMPLE_RATE_HZ:
        raise InputError(
            f"{1 / period:.3g} frames per second need a ramp longer than the card's {limits.card_samples} samples",
            f"take at least {MIN_SAMPLE_RATE_HZ * count / limits.card_samples:.3g} frames per second",
        )
    samples = floor((period - REARM_S) * rate + 1e-9)
    natural_hz = galvo.natural_hz or limits.natural_hz
    natural = 2 * pi * natural_hz if natural_hz else None
    carried = 2 * (galvo.damping or limits.damping) / natural if natural else 0.0  # the lag of the resonance itself
    begin, end = timing.time_s(rows[0] - 0.5 * timing.slit_rows), timing.time_s(rows[1] + 0.5 * timing.slit_rows)
    spare = period - (end - begin) - TURN_S - LEAD_IN_S
    lag_s = galvo.lag_s or 0.0  # not measured: the line is late
    guard = min(max(lag_s, 0.0), max(spare, 0.0) / 5)  # the ramp goes on until the flyback has no influence
    path = ScanPath(begin - 4 * guard, end + guard, timing, shifts_rows)
    fine = ceil(period * rate)  # samples of a card that were never deaf
    middles = (np.arange(fine) + 0.5) / rate  # a sample's value stands for its middle
    times = (np.arange(count)[:, None] * period + middles).ravel() + lag_s - carried
    where, speed, acceleration = path(times)
    if correction is not None:
        added = PathCorrection(correction, rows, timing)(times)
        where, speed, acceleration = where + added[0], speed + added[1], acceleration + added[2]
    slope = galvo.volts_per_row
    drive = where + (carried * speed + acceleration / natural**2 if natural else 0.0)
    drive = _bridge(drive.reshape(count, fine), samples, period * rate).ravel()
    _refuse_too_fast(abs(slope) * np.abs(speed).max(), abs(slope) * np.abs(acceleration).max(), limits)
    volts = np.asarray(galvo.volts(drive))
    limits.check(volts, "the scan")
    ends = sorted(
        galvo.volts_at_row_zero + slope * row for row in (rows[0] + min(shifts_rows), rows[1] + max(shifts_rows))
    )
    return Waveform(volts, count, rate, period, (ends[0], ends[1]))


def _bridge(drive: Volts, samples: int, period: float) -> Volts:
    """Cut each ramp to the samples that fit, without a jolt where the last one is held until the strobe.

    The last samples are changed by least squares so that the drive's mean and first two moments over them and the hold
    stay the same: a galvo slower than the hold follows the same path.
    """
    fine, first = drive.shape[1], samples - BRIDGE_SAMPLES
    starts = np.arange(first, fine)
    lasts = np.minimum(starts + 1, period) - starts
    held_by = np.minimum(starts, samples - 1) - first
    middles = starts + lasts / 2 - period
    moments = np.stack([lasts * middles**power for power in range(3)])
    merged = np.stack([np.bincount(held_by, row) for row in moments])
    short = drive[:, :samples].copy()
    wrong = moments @ drive[:, first:].T - merged @ short[:, first:].T
    short[:, first:] += (np.linalg.pinv(merged) @ wrong).T
    return short


def _refuse_too_fast(slew: float, acceleration: float, limits: GalvoLimits) -> None:
    if slew > limits.max_slew_v_per_s or acceleration > limits.max_acceleration_v_per_s2:
        raise InputError(
            f"the flyback would need {slew:.3g} V/s and {acceleration:.3g} V/s2",
            f"the galvo's limits are {limits.max_slew_v_per_s:.3g} V/s and {limits.max_acceleration_v_per_s2:.3g} "
            "V/s2: choose a lower frame rate",
        )


def flyback_rows(galvo: GalvoSection, exposed: float, limits: GalvoLimits, timing: ScanTiming) -> float:
    """Return the line periods that the galvo needs to fly back over a number of exposed rows, slit included.

    The path is the least-jerk one, whose peak speed is 15/8 and whose peak acceleration is 10/sqrt(3) of way over time
    and way over time squared; the way is relative to the moving slit, so it grows with the time taken.

    Parameters
    ----------
    galvo : GalvoSection
        Volts per row.
    exposed : float
        Rows from the first to the last exposed one, plus the slit's.
    limits : GalvoLimits
        From the rig.
    timing : ScanTiming
        From the camera.
    """
    line, slope = timing.line_period_s, abs(galvo.volts_per_row)
    speed = 1 / line
    slew_rows, bend_rows = limits.max_slew_v_per_s / slope, limits.max_acceleration_v_per_s2 / slope
    if 1.875 * speed >= slew_rows + speed:
        return float("inf")
    by_slew = 1.875 * exposed / (slew_rows - 0.875 * speed)
    k = 10 / sqrt(3) / bend_rows  # time^2 = k (exposed + speed time)
    by_bend = 0.5 * (k * speed + sqrt((k * speed) ** 2 + 4 * k * exposed))
    return max(by_slew, by_bend) / line


def _refuse_without_time(
    galvo: GalvoSection, span: float, offset: float, timing: ScanTiming, limits: GalvoLimits
) -> None:
    exposed = span + timing.slit_rows
    free, needed = timing.line_periods_per_frame - exposed, flyback_rows(galvo, exposed, limits, timing)
    if free >= needed:
        return
    wrong = (
        f"the galvo needs {needed:.1f} rows ({needed * timing.line_period_s * 1e3:.2f} ms) to fly back and has "
        f"{free:.1f} ({free * timing.line_period_s * 1e3:.2f} ms) while neither image is exposed"
    )
    slower = floor(1 / (timing.line_period_s * (exposed + needed))) if isfinite(needed) else 0
    within = [
        candidate
        for candidate in range(ceil(abs(offset)))
        if timing.line_periods_per_frame - (exposed - abs(offset) + candidate)
        >= flyback_rows(galvo, exposed - abs(offset) + candidate, limits, timing)
    ]
    choice = f"an offset of at most {within[-1]} rows (it is {abs(offset):.1f})" if within else "no offset"
    raise InputError(wrong, f"{choice} would fit this frame rate; this offset fits {slower} frames per second")
