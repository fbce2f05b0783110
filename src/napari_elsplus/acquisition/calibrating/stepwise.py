"""The calibration's steps one by one on a live rig, each with its target before the probe."""

from __future__ import annotations

from typing import TYPE_CHECKING

from napari_elsplus.acquisition.calibrating import procedures
from napari_elsplus.acquisition.calibrating.whole import Target
from napari_elsplus.hardware.virtual.frame_source import Circle
from napari_elsplus.instrument.optics import preset
from napari_elsplus.processing.calibration.calibrate import Background, locate_pair, mean_frame, measure_flat
from napari_elsplus.processing.calibration.draft import Flat, LitPair, Setup
from napari_elsplus.simulation.specimen.scenes import distal_light, empty, fibres, uniform

if TYPE_CHECKING:
    from napari_elsplus.acquisition.calibrating.procedures import Watch
    from napari_elsplus.acquisition.engine.engine import Engine
    from napari_elsplus.hardware.rig import Rig
    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.processing.calibration.lag import ScanLag


def setup(engine: Engine) -> Setup:
    """Say what frames are taken with now."""
    chosen = preset(engine.setup.settings.preset)
    return Setup(
        engine.setup.frame,
        engine.setup.acquired_with,
        engine.setup.line_period_s,
        engine.setup.line_periods_per_frame,
        chosen.optics.um_per_px,
    )


def prepare(rig: Rig, target: Target | None) -> bool:
    """Put a target before the simulated rig's probe; None puts moving lens tissue there.

    Returns
    -------
    bool
        Whether that was done; before a real probe only its user can put something.
    """
    if rig.bench is None:
        return False
    match target:
        case Target.FAR_END_LIT:
            rig.bench.optics.show(distal_light())
        case Target.FLUORESCENT:
            rig.bench.optics.show(uniform())
        case Target.DARK_TUBE:
            rig.bench.optics.show(empty())
        case None:
            rig.bench.optics.show(fibres(), Circle())
    return True


def lit_pair(engine: Engine) -> LitPair:
    """Step (iii) live, with the frame in which the pair was found."""
    frames = procedures.take_parked(engine, procedures.BUNDLE_FRAMES)
    return LitPair(locate_pair(frames), mean_frame(frames))


def lag_by(engine: Engine, calibration: Calibration, watch: Watch = iter) -> ScanLag:
    """Measure the scan's lag by a calibration that knows galvo and bundle."""
    engine.use(calibration)
    return procedures.lag(engine, watch)


def background_by(engine: Engine, calibration: Calibration) -> Background:
    """Take the background, scanning as a calibration says."""
    engine.use(calibration)
    return procedures.background(engine)


def flat_by(engine: Engine, calibration: Calibration) -> Flat:
    """Take a flat field from an evenly fluorescent target, scanning as a calibration says."""
    calibration.require("galvo", "bundle")
    engine.use(calibration)
    return Flat(measure_flat(procedures.take_scanned(engine, procedures.BACKGROUND_FRAMES), calibration))
