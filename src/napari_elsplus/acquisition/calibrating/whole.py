"""A whole calibration on a live rig: every step of ``calibrating.procedures`` in its safe order."""

from __future__ import annotations

from dataclasses import replace
from enum import StrEnum
from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.acquisition.calibrating import procedures
from napari_elsplus.errors import MeasurementError
from napari_elsplus.instrument.optics import BUNDLE_UM
from napari_elsplus.processing.calibration.calibrate import Findings, measure, measure_background

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from napari_elsplus.acquisition.calibrating.procedures import Watch
    from napari_elsplus.acquisition.engine.engine import Engine
    from napari_elsplus.processing.calibration.lag import ScanLag

SEARCH_VOLTAGES: Final = 61
SWEEP_VOLTAGES: Final = 400
"""As many as the paper takes."""
_VISIBLE: Final = 0.25
"""Part of the brightest line's height at which a line counts as on the bundle."""


class Target(StrEnum):
    """What must lie before the probe for a step."""

    FAR_END_LIT = "light the bundle from its far end"
    FLUORESCENT = "put the probe onto an evenly fluorescent target"
    DARK_TUBE = "put the probe into the dark tube"


def calibrate_rig(
    engine: Engine,
    prepare: Callable[[Target], None],
    *,
    voltages: int = SWEEP_VOLTAGES,
    bundle_um: float = BUNDLE_UM,
    watch: Callable[[str], Watch] = lambda _: iter,
) -> tuple[Findings, ScanLag]:
    """Calibrate a rig from nothing, and take the result into force.

    Parameters
    ----------
    engine : Engine
        Configured.
    prepare : callable
        Asks for a target, and returns when it is there.
    voltages : int
        Steps of the sweep.
    bundle_um : float
        Diameter of the bundle's image.
    watch : callable
        Gives for the name of a step what wraps its numbers, to show how far it is, or to give up.

    Returns
    -------
    Findings
        What was measured; its calibration is complete, the scan's lag included.
    ScanLag
        How the lag was measured.

    Raises
    ------
    MeasurementError
        If a step finds nothing; the calibration before stays in force.
    DeviceError
        If camera or mirror fail.
    """
    before = engine.calibration
    engine.use(None)
    try:
        return _calibrate(engine, prepare, voltages, bundle_um, watch)
    except BaseException:
        engine.use(before)
        raise


def _calibrate(
    engine: Engine,
    prepare: Callable[[Target], None],
    voltages: int,
    bundle_um: float,
    watch: Callable[[str], Watch],
) -> tuple[Findings, ScanLag]:
    prepare(Target.FAR_END_LIT)
    lit = procedures.take_parked(engine, procedures.BUNDLE_FRAMES)
    prepare(Target.FLUORESCENT)
    low, high = span_of_the_bundle(engine, watch("search"))
    volts = np.linspace(low, high, voltages)
    line = procedures.take_line(engine, (low + high) / 2)
    sweep = procedures.take_sweep(engine, volts, watch("sweep"))
    findings = measure(
        line=line,
        sweep=sweep,
        volts=volts,
        bundle=lit,
        bundle_um=bundle_um,
        line_period_s=engine.setup.line_period_s,
        line_periods_per_frame=engine.setup.line_periods_per_frame,
        watch=watch("fit"),
    )
    calibration = findings.calibration
    calibration = calibration.model_copy(
        update={
            "acquired_with": engine.setup.acquired_with,
            "frame": engine.setup.frame,
        }
    )
    engine.use(calibration)
    lag = procedures.lag(engine, watch("lag"))
    assert calibration.galvo is not None
    galvo = calibration.galvo.model_copy(update={"lag_s": lag.lag_s, "lag_uncertainty_s": lag.uncertainty_s})
    calibration = calibration.model_copy(update={"galvo": galvo})
    engine.use(calibration)
    prepare(Target.DARK_TUBE)
    dark = measure_background(procedures.take_scanned(engine, procedures.BACKGROUND_FRAMES))
    calibration = calibration.model_copy(update={"background": dark.mean})
    engine.use(calibration)
    return replace(findings, background=dark, calibration=calibration), lag


def span_of_the_bundle(engine: Engine, watch: Watch = iter) -> tuple[float, float]:
    """Find the voltages between which the line stands on the bundle, searching all that the rig allows.

    Raises
    ------
    MeasurementError
        If no voltage puts a line onto the bundle.
    """
    volts = np.linspace(engine.mirror.limits.min_v, engine.mirror.limits.max_v, SEARCH_VOLTAGES)
    dark = procedures.take_parked(engine, procedures.LINE_FRAMES).mean(axis=0)
    heights = _heights(procedures.take_sweep(engine, volts, watch), dark)
    seen = np.flatnonzero(heights > _VISIBLE * heights.max())
    noise = float(np.median(heights))
    if not heights.max() > 3 * max(noise, 1.0) or len(seen) > 0.7 * len(volts):
        raise MeasurementError(
            f"no voltage from {volts[0]:g} to {volts[-1]:g} V puts a line onto the bundle "
            f"(brightest row {heights.max():.1f} grey levels)",
            "is the laser on, and the target fluorescent? widen the mirror's range in the rig's file if it is",
        )
    step = volts[1] - volts[0]
    low, high = volts[seen[0]] - step, volts[seen[-1]] + step
    return max(float(low), engine.mirror.limits.min_v), min(float(high), engine.mirror.limits.max_v)


def _heights(frames: NDArray[np.uint8], dark: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean grey level of each frame's brightest row, above the dark frame."""
    dark_rows = dark.mean(axis=1)
    return np.array([float((frame.mean(axis=1) - dark_rows).max()) for frame in frames])
