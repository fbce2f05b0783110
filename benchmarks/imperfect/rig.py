"""An imperfect instrument, the frames that it gives, and its calibration as a user would measure it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final, Self

import numpy as np

from napari_elsplus.hardware.scan.following import drive_of, highest_rate_hz
from napari_elsplus.hardware.scan.timing import ScanTiming
from napari_elsplus.hardware.scan.waveform import GalvoLimits, els_waveform
from napari_elsplus.hardware.virtual.galvo import GalvoModel
from napari_elsplus.hardware.virtual.steady_scan import driven_line_rows
from napari_elsplus.instrument.calibration import AcquiredWith
from napari_elsplus.processing.calibration.calibrate import measure
from napari_elsplus.processing.calibration.draft import Setup
from napari_elsplus.processing.calibration.step import StepInputs
from napari_elsplus.processing.calibration.steps import find_step
from napari_elsplus.simulation import calibration_scenes
from napari_elsplus.simulation.axial_scan import axial_scan, lit_for_plate
from napari_elsplus.simulation.model.bundle import Bundle
from napari_elsplus.simulation.model.imperfections import IDEAL, Imperfections
from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.simulation.rendering.renderer import Renderer
from napari_elsplus.simulation.specimen.scenes import uniform

if TYPE_CHECKING:
    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.processing.calibration.draft import Draft
    from napari_elsplus.processing.calibration.scan.galvo_response import Drive
    from napari_elsplus.simulation.rendering.frames import RenderedFrames
    from napari_elsplus.simulation.specimen.scenes import Scene
    from napari_elsplus.simulation.specimen.trajectories import Trajectory

    Frame = np.ndarray[Any, np.dtype[np.uint8]]
    Rows = np.ndarray[Any, np.dtype[np.float64]]

SEEDS: Final = {"line": 101, "sweep": 102, "bundle": 103, "background": 104, "scan": 105}
"""Seeds of the camera's noise in the recordings of a calibration, unlike those of the recordings that it serves."""
UNSTATED: Final = GalvoLimits()
"""A rig file that states nothing about its galvo's resonance."""


@dataclass(frozen=True)
class ImperfectRig:
    """An instrument with its imperfections.

    Parameters
    ----------
    instrument : Instrument
        Optics, bundle, camera, imperfections.
    voltages : int
        Of the galvo sweep.
    seed : int
        Of the noise of its recordings: camera, laser, jitter of the line.
    """

    instrument: Instrument
    voltages: int = 100
    seed: int = 0

    @classmethod
    def of(
        cls, preset: str, imperfections: Imperfections = IDEAL, *, voltages: int = 100, seed: int = 0, **fields: Any
    ) -> Self:
        """Return a rig of one of the camera's presets.

        Parameters
        ----------
        preset : str
            ``"120hz"`` or ``"240hz"``.
        imperfections : Imperfections
            Departures from the ideal instrument.
        voltages : int
            Of the galvo sweep.
        seed : int
            Of the noise of its recordings.
        **fields
            As of :meth:`Instrument.of`.
        """
        return cls(Instrument.of(preset, imperfections=imperfections, **fields), voltages, seed)

    @classmethod
    def drawn(cls, preset: str, seed: int, rate_hz: float | None = None) -> Self:
        """Return a rig drawn at random, with a bundle of its own, at the preset's frame rate or another."""
        voltages, bundle = calibration_scenes.SWEEP_STEPS, Bundle(seed=seed)
        return cls.of(preset, Imperfections.drawn(seed), bundle=bundle, voltages=voltages, rate_hz=rate_hz, seed=seed)

    @cached_property
    def measured(self) -> Draft:
        """The calibration from recordings: line, sweep, lamp and dark tube, without the full-speed scan.

        Raises
        ------
        ElsPlusError
            If a step refuses its frames.
        """
        instrument, optics = self.instrument, self.instrument.optics
        volts = calibration_scenes.sweep_volts(instrument)[:: max(1, calibration_scenes.SWEEP_STEPS // self.voltages)]
        # A live sweep takes a time of its own for each voltage. At equal steps of row and time, a ripple of the power
        # could have one phase in all lines; in a random order of the voltages it has not.
        volts = np.random.default_rng(self.recording_seed("sweep")).permutation(volts)
        held_volts = np.full(find_step("offset").frames, calibration_scenes.line_volts(instrument)[0])
        return measure(
            line=self.line_frames(held_volts, self.recording_seed("line")),
            sweep=self.line_frames(volts, self.recording_seed("sweep")),
            volts=volts,
            bundle=list(calibration_scenes.transmission(instrument, seed=self.recording_seed("bundle"))),
            background=list(calibration_scenes.dark_tube(instrument, seed=self.recording_seed("background"))),
            um_per_px=optics.um_per_px,
            line_period_s=optics.line_period_s,
            line_periods_per_frame=optics.line_periods_per_frame,
        )

    def recording_seed(self, recording: str) -> int:
        """Return the seed of the noise in one of the recordings of `SEEDS`."""
        return SEEDS[recording] + 1000 * self.seed

    def line_frames(self, volts: Rows, seed: int) -> list[Frame]:
        """Return frames of a standing line, one at each voltage."""
        return list(calibration_scenes.standing_line(self.instrument, volts, seed=seed))

    @cached_property
    def scanned(self) -> Draft:
        """The calibration with the full-speed scan, which learns the ramp; the rig states nothing about its galvo.

        Raises
        ------
        ElsPlusError
            If a step refuses its frames.
        """
        step, draft, setup = find_step("lag"), self.measured, self.setup
        return step.accept(draft, step.estimate(StepInputs((), setup, scans=_Scans(self)), draft), setup)

    @property
    def setup(self) -> Setup:
        """Settings of the devices, as a step gets them."""
        frame, instrument = self.measured.calibration.frame, self.instrument
        assert frame is not None
        optics = instrument.optics
        acquired = AcquiredWith(slit_rows=instrument.slit_rows, frame_rate_hz=optics.frame_rate_hz)
        return Setup(frame, acquired, optics.line_period_s, optics.line_periods_per_frame, optics.um_per_px)

    @property
    def timing(self) -> ScanTiming:
        """Exposure times of the rows."""
        optics = self.instrument.optics
        return ScanTiming(optics.line_period_s, optics.line_periods_per_frame, round(self.instrument.slit_rows))

    def line_rows(self, calibration: Calibration) -> Rows:
        """Return the line positions (rows,) of the scan that a calibration drives."""
        return driven_line_rows(self.instrument, calibration, UNSTATED, GalvoModel())

    def renderer(self, scene: Scene, trajectory: Trajectory | None = None, *, seed: int = 0) -> Renderer:
        """Return a renderer of a scene."""
        return Renderer(self.instrument, scene, trajectory, seed=seed)

    def axial_scan(self, depths_um: Rows, *, seed: int = 0, line_rows: Rows | None = None) -> RenderedFrames:
        """Return a scan of depths of a stained plate."""
        return axial_scan(lit_for_plate(self.instrument), depths_um, seed=seed, line_rows=line_rows)


class _Scans:
    """Scans of an even target by trial calibrations, rendered without camera and card."""

    def __init__(self, rig: ImperfectRig) -> None:
        self._rig = rig
        self._renderer = rig.renderer(uniform(), seed=rig.recording_seed("scan"))
        self._taken = 0

    def frames(self, calibration: Calibration, count: int) -> list[Frame]:
        """Render a count of frames of a scan by a calibration."""
        line_rows = self._rig.line_rows(calibration)
        first, self._taken = self._taken, self._taken + count
        return [self._renderer.render(k, line_rows=line_rows) for k in range(first, self._taken)]

    def drive(self, calibration: Calibration) -> Drive:
        """Return the drive of a scan by a calibration."""
        assert calibration.galvo is not None
        timing = self._rig.timing
        return drive_of(els_waveform(calibration, timing, UNSTATED), calibration.galvo, timing)

    def highest_rate_hz(self, calibration: Calibration) -> float:
        """Return the highest frame rate at which the galvo's limits allow a scan."""
        return highest_rate_hz(calibration, self._rig.timing, UNSTATED)
