"""Position of the laser line: one tilted Gaussian for all columns, a profile, a mean, a centroid, a maximum.

Frames are those of rigs drawn at random (:mod:`benchmarks.rigs.random_rigs`), which share nothing with the
estimators: cores of unequal brightness, a halo, tilts up to 2 degrees.
"""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import OptimizeWarning, curve_fit

from benchmarks.harness.methods import Benchmark, Case, Judgement, Method, Role, plain
from benchmarks.rigs.random_rigs import Rig
from napari_elsplus.errors import MeasurementError
from napari_elsplus.processing.calibration.line.location import locate_line

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

WRONG_ROWS = 1.0
"""A slit of three rows that is a row off the line loses a good part of the light."""
TYPICAL_WIDTH_ROWS = 2.5


class Frame(NamedTuple):
    """The confocal view of a standing line above the dark level, and the true row at a column in its middle."""

    view: NDArray[np.float32]
    column: int
    row: float


def frame(rig: Rig, row: float = 1.3) -> Frame:
    """One frame of a rig, the line standing that far from the centre."""
    split = round((rig.left[1] + rig.right[1]) / 2)
    view = rig.line(1, row)[0][:, :split].astype(np.float32)
    column = round(rig.left[1])
    risen = np.tan(np.radians(rig.tilt_deg)) * (column - rig.left[1])
    return Frame(view - np.float32(rig.black_dn), column, float(rig.left[0] + row + risen))


def _cases(quick: bool) -> list[Case]:
    seeds = range(2 if quick else 16)
    lights = (
        {"bright, 1000 electrons": 1000.0} if quick else {"bright, 1000 electrons": 1000.0, "dim, 30 electrons": 30.0}
    )
    return [
        Case(name, [frame(Rig.draw(seed).with_photons(photons)) for seed in seeds]) for name, photons in lights.items()
    ]


def judge(item: Frame, answer: float) -> Judgement:
    """Distance in rows at the centre's column."""
    error = abs(answer - item.row)
    return Judgement(error, failed=not error <= WRONG_ROWS)


def tilted_gaussian(item: Frame) -> float:
    """Ours."""
    return locate_line(item.view).row_at(item.column)


def brightest_pixel(item: Frame) -> float:
    """Take the brightest pixel of one profile, as the paper does for the galvo map."""
    return float(item.view[:, item.column].argmax())


def gaussian_of_profile(item: Frame) -> float:
    """Threshold one profile and fit a Gaussian to it, as the paper does for the offset."""
    return _gaussian(item.view[:, item.column])


def gaussian_of_mean(item: Frame) -> float:
    """Fit a Gaussian to the mean of the middle columns."""
    return _gaussian(mean_profile(item))


def centroid_of_mean(item: Frame) -> float:
    """Centre of mass above half the maximum of the mean of the middle columns."""
    profile = mean_profile(item)
    above = np.clip(profile - 0.5 * profile.max(), 0, None)
    return float((above * np.arange(len(above))).sum() / above.sum())


def matched_filter(item: Frame) -> float:
    """Correlate the mean of the middle columns with a line of a typical width; a parabola refines the maximum."""
    response = gaussian_filter1d(mean_profile(item), TYPICAL_WIDTH_ROWS)
    peak = int(np.clip(response.argmax(), 1, len(response) - 2))
    before, at, after = (float(value) for value in response[peak - 1 : peak + 2])
    return peak + 0.5 * (before - after) / (before - 2 * at + after)


def mean_profile(item: Frame) -> NDArray[np.float32]:
    """Mean of the middle columns, (rows,)."""
    half = item.view.shape[1] // 8
    mean: NDArray[np.float32] = item.view[:, item.column - half : item.column + half + 1].mean(axis=1)
    return mean


def _gaussian(profile: NDArray[np.float32]) -> float:
    rows = np.arange(len(profile), dtype=float)
    peak = int(profile.argmax())
    bright = np.where(profile > 0.2 * profile[peak], profile, 0.0)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", OptimizeWarning)  # only the covariance, which is not used
            (_, centre, _), _ = curve_fit(bell, rows, bright, p0=(profile[peak], peak, 2.0), maxfev=400)
    except RuntimeError:
        raise MeasurementError("no Gaussian fits the profile", "more light") from None
    return float(centre)


def bell(rows: Floats, height: float, centre: float, width: float) -> Floats:
    """Return a Gaussian at some rows."""
    return np.asarray(height * np.exp(-((rows - centre) ** 2) / (2 * width**2)), np.float64)


METHODS = (
    Method("tilted Gaussian, all columns", Role.DEFAULT, plain(tilted_gaussian), 6),
    Method("Gaussian, one profile", Role.PAPER, plain(gaussian_of_profile), 3),
    Method("brightest pixel", Role.PAPER, plain(brightest_pixel), 1),
    Method("Gaussian, mean of columns", Role.OPTION, plain(gaussian_of_mean), 3),
    Method("centroid, mean of columns", Role.OPTION, plain(centroid_of_mean), 1),
    Method("matched filter, mean of columns", Role.OPTION, plain(matched_filter), 1),
)

BENCHMARK = Benchmark(
    name="line",
    question="Where the laser line stands",
    error_label="error / rows",
    cases=_cases,
    methods=METHODS,
    judge=judge,
    remarks=(
        "The fit also gives tilt and uncertainty, and refuses what is no line; the others do not. It runs while "
        "calibrating, where a few milliseconds a frame cost nothing."
    ),
)
