"""Model selection for the profile of the laser line: a Gaussian, its floor, the floor's slope, the halo.

All models are fitted to the same mean of the middle columns of a line without tilt.
"""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import OptimizeWarning, curve_fit

from benchmarks.choices.line import Frame, bell, frame, judge, mean_profile, tilted_gaussian
from benchmarks.harness.methods import Benchmark, Case, Chart, Method, Role
from benchmarks.rigs.random_rigs import Rig
from napari_elsplus.errors import MeasurementError

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

_FITTED_ROWS = 60


def _cases(quick: bool) -> list[Case]:
    seeds = range(2 if quick else 16)
    made = []
    for name, share, place in (
        ("a third of the light in the halo", 0.33, 0.0),
        ("two thirds of the light in the halo", 0.67, 0.0),
        ("two thirds, the line near the rim", 0.67, 0.7),
    )[: 1 if quick else None]:
        rigs = [replace(Rig.draw(seed).with_photons(300.0), tilt_deg=0.0, halo_share=share) for seed in seeds]
        made.append(Case(name, [frame(rig, place * rig.diameter_px / 2 + 0.3) for rig in rigs]))
    return made


def _on_floor(rows: Floats, height: float, centre: float, width: float, floor: float) -> Floats:
    return np.asarray(bell(rows, height, centre, width) + floor, np.float64)


def _on_slope(rows: Floats, height: float, centre: float, width: float, floor: float, slope: float) -> Floats:
    return np.asarray(bell(rows, height, centre, width) + floor + slope * (rows - rows.mean()), np.float64)


def _with_halo(
    rows: Floats, height: float, centre: float, width: float, floor: float, halo: float, reach: float
) -> Floats:
    return np.asarray(bell(rows, height, centre, width) + bell(rows, halo, centre, reach) + floor, np.float64)


def _fitted(model: Callable[..., Floats], more: tuple[float, ...]) -> Callable[[Case], Callable[[Frame], float]]:
    def locate(item: Frame) -> float:
        profile = mean_profile(item).astype(float)
        peak = int(profile.argmax())
        low, high = max(0, peak - _FITTED_ROWS // 2), min(len(profile), peak + _FITTED_ROWS // 2)
        rows = np.arange(low, high, dtype=float)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", OptimizeWarning)  # only the covariance, which is not used
                found, _ = curve_fit(model, rows, profile[low:high], p0=(profile[peak], peak, 2.0, *more), maxfev=2000)
        except RuntimeError:
            raise MeasurementError("the model does not fit the profile", "take a simpler one") from None
        return float(found[1])

    return lambda _: locate


METHODS = (
    Method("Gaussian", Role.PAPER, _fitted(bell, ()), 3),
    Method("and a floor", Role.OPTION, _fitted(_on_floor, (0.0,)), 4),
    Method("and its slope", Role.OPTION, _fitted(_on_slope, (0.0, 0.0)), 5),
    Method("all columns, floor, slope, tilt", Role.DEFAULT, lambda _: tilted_gaussian, 6),
    Method("floor and halo", Role.OPTION, _fitted(_with_halo, (0.0, 5.0, 20.0)), 6),
)

BENCHMARK = Benchmark(
    name="parsimony-line",
    question="How much to model of the laser line's profile",
    error_label="error / rows",
    cases=_cases,
    methods=METHODS,
    judge=judge,
    chart=Chart.PARSIMONY,
)
