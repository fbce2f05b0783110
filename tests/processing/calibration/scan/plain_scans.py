"""Scans of a plain model rig: a galvo stepped in time, and rows of Gaussian light; shares nothing with the estimate."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import expm
from scipy.signal import lfilter

from napari_elsplus.hardware.scan.following import drive_of, highest_rate_hz
from napari_elsplus.hardware.scan.timing import ScanTiming
from napari_elsplus.hardware.scan.waveform import GalvoLimits, els_waveform
from napari_elsplus.instrument.calibration import Calibration
from napari_elsplus.instrument.optics import PRESETS
from napari_elsplus.processing.calibration.draft import Setup
from napari_elsplus.processing.calibration.scan.galvo_response import Drive
from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.simulation.truth import true_calibration

STEP_S = 1e-6
PERIODS = 5
SLIT_ROWS = 3


@dataclass
class PlainScans:
    """A rig whose galvo the calibration does not know."""

    preset: str = "240hz"
    natural_hz: float = 800.0
    damping: float = 0.5
    delay_s: float = 0.0
    cubic_rows: float = 0.0
    line_rows: float = 4.0
    light_dn: float = 60.0
    limits: GalvoLimits = field(default_factory=GalvoLimits)
    seed: int = 0
    rate_hz: float | None = None
    taken: int = 0

    def __post_init__(self) -> None:
        self.calibration: Calibration = true_calibration(Instrument.of(self.preset))
        optics, bundle = PRESETS[self.preset].optics, self.calibration.bundle
        periods = optics.line_periods_per_frame if self.rate_hz is None else 1 / (self.rate_hz * optics.line_period_s)
        self.timing = ScanTiming(optics.line_period_s, periods, SLIT_ROWS)
        self.shape = PRESETS[self.preset].frame_shape
        self.centres = np.array([bundle.confocal_centre, bundle.residual_centre])
        self.radius = bundle.diameter_px / 2
        row, col = np.ogrid[: self.shape[0], : self.shape[1]]
        self.discs = [np.hypot(row - r, col - c) < self.radius for r, c in self.centres]
        self.rows = np.arange(self.shape[0], dtype=np.float64)
        random = np.random.default_rng(self.seed)
        self.noise = random.normal(4, 0.6, (self.shape[0] + 64, self.shape[1])).astype(np.float32)
        omega = 2 * np.pi * self.natural_hz
        system = np.array([[0, 1, 0], [-omega * omega, -2 * self.damping * omega, omega * omega], [0, 0, 0]])
        self.step = expm(system * STEP_S)

    @property
    def setup(self) -> Setup:
        known = self.calibration
        timing = self.timing
        return Setup(known.frame, known.acquired_with, timing.line_period_s, timing.line_periods_per_frame)

    def exposed_rows(self) -> np.ndarray:
        """Rows in which the line lies on the bundle."""
        return self.rows[np.abs(self.rows - self.centres[0, 0]) < self.radius - 1]

    def line_at(self, calibration: Calibration) -> np.ndarray:
        """Row of the line in the middle of each row's exposure, once the motion repeats."""
        waveform, period = els_waveform(calibration, self.timing, self.limits), self.timing.frame_period_s
        count = round(period / STEP_S)
        times = (np.arange(count) + 0.5) * period / count
        drive = waveform.volts[np.minimum((times * waveform.sample_rate_hz).astype(int), len(waveform.volts) - 1)]
        a, first = self.step, waveform.volts[0]
        forward = [0, a[0, 2], a[0, 1] * a[1, 2] - a[1, 1] * a[0, 2]]
        back = [1, -a[0, 0] - a[1, 1], a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0]]
        volts = lfilter(forward, back, np.tile(drive, PERIODS) - first)[-count:] + first
        middle = self.timing.row_zero_s + (self.rows - SLIT_ROWS / 2) * self.timing.line_period_s - self.delay_s
        row = self.calibration.galvo.row(np.interp(middle % period, times, volts, period=period))
        u = (row - self.centres[0, 0]) / self.radius
        return row + self.cubic_rows * (2.5 * u**3 - 1.5 * u)

    def errors(self, calibration: Calibration) -> np.ndarray:
        """Row of the line minus row of the slit, where the line lies on the bundle."""
        exposed = self.exposed_rows().astype(int)
        return (self.line_at(calibration) - self.rows)[exposed]

    def signal(self, calibration: Calibration) -> float:
        """Light that passes the slit over that of a perfect scan."""
        return float(np.exp(-0.5 * np.square(self.errors(calibration) / self.line_rows)).mean())

    # the protocol

    def frames(self, calibration: Calibration, count: int) -> list[np.ndarray]:
        line = self.line_at(calibration)
        on = np.abs(line - self.centres[0, 0]) < self.radius
        self.taken += count
        frames = []
        for number in range(count):
            at = (7 * self.taken + 13 * number) % 64
            frame = self.noise[at : at + self.shape[0]].copy()
            for disc, (centre, _) in zip(self.discs, self.centres, strict=True):
                away = line + centre - self.centres[0, 0] - self.rows
                light = 0.6 * np.exp(-0.5 * (away / self.line_rows) ** 2) + 0.4 * np.exp(-0.5 * (away / 25) ** 2)
                frame += disc * (self.light_dn * on * light)[:, None].astype(np.float32)
            frames.append(frame.astype(np.uint8))
        return frames

    def drive(self, calibration: Calibration) -> Drive:
        return drive_of(els_waveform(calibration, self.timing, self.limits), calibration.galvo, self.timing)

    def highest_rate_hz(self, calibration: Calibration) -> float:
        return highest_rate_hz(calibration, self.timing, self.limits)
