"""History of calibrations: each number over days, with a warning where it drifts or has jumped."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from math import sqrt
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from scipy.stats import linregress, t

from napari_elsplus.errors import CalibrationError, InputError
from napari_elsplus.io import read_calibration
from napari_elsplus.io.calibration_lookup import is_calibration
from napari_elsplus.io.formats.registry import CALIBRATION
from napari_elsplus.workflows.calibration_report.picture import Plot
from napari_elsplus.workflows.pictures.curves import Curve

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import Calibration

MIN_TESTED: Final = 4
"""Calibrations from which drift is tested; chosen: two degrees of freedom are left by a straight line."""
CONFIDENCE: Final = 0.999
"""Of both tests; chosen: of ten stable numbers a day, one is reported in seven weeks."""
_DAY_S: Final = 86_400.0
"""Seconds of a day."""


@dataclass(frozen=True)
class Trend:
    """One number of a calibration over time.

    Parameters
    ----------
    name, unit : str
        Quantity and unit.
    days : numpy.ndarray
        (n,) float64 times relative to the newest calibration, days, ascending; at most 0.
    values : numpy.ndarray
        (n,) float64.
    sigmas : numpy.ndarray
        (n,) float64 standard deviations; 0 where none is stated.
    """

    name: str
    unit: str
    days: NDArray[np.float64]
    values: NDArray[np.float64]
    sigmas: NDArray[np.float64]

    @property
    def label(self) -> str:
        """Quantity and unit, as of an axis."""
        return f"{self.name} / {self.unit}" if self.unit else self.name

    @property
    def plot(self) -> Plot:
        """The values over the days, with a band of one standard deviation."""
        curves = [Curve(self.name, self.days, self.values, "blue", marks=True, listed=False)]
        if self.sigmas.any():
            curves += [
                Curve(f"{sign}1 SD", self.days, self.values + factor * self.sigmas, "grey", "dotted", listed=False)
                for sign, factor in (("+", 1), ("-", -1))
            ]
        return Plot("days before the newest calibration", self.label, curves)

    @property
    def warning(self) -> str:
        """What is not explained by scatter: a jump of the newest value, or a drift; empty if there is none.

        A jump is a newest value outside the prediction interval of those before; a drift is a slope of the straight
        line through all values that differs from 0, both with the confidence :data:`CONFIDENCE`.
        """
        if len(self.values) < MIN_TESTED:
            return ""
        *_, newest = self.values
        before = self.values[:-1]
        scatter = max(float(before.std(ddof=1)), sqrt(float((self.sigmas[:-1] ** 2).mean())))
        limit = self._quantile(len(before) - 1) * sqrt(scatter**2 * (1 + 1 / len(before)) + float(self.sigmas[-1]) ** 2)
        change = float(newest - before.mean())
        if abs(change) > limit:
            return f"{self.name}: the newest differs by {change:+.3g} {self.unit} from the {len(before)} before".strip()
        if np.ptp(self.days) > 0:
            line = linregress(self.days, self.values)
            spread = float(np.hypot(line.stderr, sqrt((self.sigmas**2).mean()) / sqrt(_sum_of_squares(self.days))))
            if abs(line.slope) > self._quantile(len(self.values) - 2) * spread:
                unit = f"{self.unit} " if self.unit else ""
                return f"{self.name} drifts by {line.slope:+.3g} {unit}a day"
        return ""

    @staticmethod
    def _quantile(freedom: int) -> float:
        return float(t.ppf((1 + CONFIDENCE) / 2, freedom))


@dataclass(frozen=True)
class CalibrationHistory:
    """Trends of the numbers of comparable calibrations, those of the newest one's rig and objective.

    Parameters
    ----------
    files : sequence of pathlib.Path
        The calibrations, oldest first.
    trends : sequence of Trend
        A trend for each number that the newest one contains.
    """

    files: Sequence[Path]
    trends: Sequence[Trend]

    @property
    def warnings(self) -> list[str]:
        """Warnings of all trends."""
        return [trend.warning for trend in self.trends if trend.warning]


def calibration_history(folder: Path) -> CalibrationHistory:
    """Return the history of the calibrations in a folder, by the times at which they were measured.

    Parameters
    ----------
    folder : pathlib.Path
        Calibrations of another rig, objective or frame than the newest one's, and files that cannot be read, are left
        out.

    Raises
    ------
    InputError
        If the folder has no calibration.
    """
    found = sorted(_dated(folder), key=lambda one: one[0])
    if not found:
        raise InputError(f"{folder} has no calibration", "save one there first")
    newest_s, newest, _ = found[-1]
    comparable = (one for one in found if _identity(one[1]) == _identity(newest))
    kept = list({one[0]: one for one in comparable}.values())  # a copy counts once
    trends = []
    for quantity in filter(lambda one: one.watched, QUANTITIES):
        points = [((time_s - newest_s) / _DAY_S, *value) for time_s, one, _ in kept if (value := quantity.of(one))]
        if points and points[-1][0] == 0:
            days, values, sigmas = np.array(points, np.float64).T
            trends.append(Trend(quantity.name, quantity.unit, days, values, sigmas))
    return CalibrationHistory([path for _, _, path in kept], trends)


def history_beside(file: Path | None) -> CalibrationHistory | None:
    """Return the history of the calibrations in the folder of a calibration file; None for one that was not saved."""
    return None if file is None else calibration_history(file.parent)


def _dated(folder: Path) -> Iterator[tuple[float, Calibration, Path]]:
    for path in sorted(folder.iterdir()):
        if path.suffix.lower() in CALIBRATION.suffixes and is_calibration(path):
            try:
                calibration = read_calibration(path)
                yield datetime.fromisoformat(calibration.created).timestamp(), calibration, path
            except (CalibrationError, ValueError):
                continue


def _identity(calibration: Calibration) -> tuple[object, ...]:
    taken, frame = calibration.acquired_with, calibration.frame
    rig = (None, None) if taken is None else (taken.rig, taken.objective)
    return *rig, None if frame is None else frame.shape


def _sum_of_squares(days: NDArray[np.float64]) -> float:
    return float(((days - days.mean()) ** 2).sum())


class Quantity(NamedTuple):
    """A number of a calibration, for its report and for the history of a rig's calibrations.

    Parameters
    ----------
    name, unit : str
        As displayed.
    step : str
        Key of the calibration step that measures it; empty for what the camera states.
    section, value : str
        Section of the calibration, and its field with the number.
    sigma : str
        Field with the standard deviation; empty where none is stated.
    factor : float or None
        From the field's unit to the displayed one; None: micrometres per pixel of the calibration.
    watched : bool
        Its history is tested for drift.
    """

    name: str
    unit: str
    step: str
    section: str
    value: str
    sigma: str = ""
    factor: float | None = 1.0
    watched: bool = True

    def of(self, calibration: Calibration) -> tuple[float, float] | None:
        """Return value and standard deviation (0 where none is stated) in a `calibration`; None where not measured."""
        section = getattr(calibration, self.section)
        value = getattr(section, self.value, None)
        factor = calibration.um_per_px if self.factor is None else self.factor
        if value is None or factor is None:
            return None
        return factor * value, factor * (getattr(section, self.sigma, None) or 0.0)


QUANTITIES: Final = (
    Quantity("slit offset", "rows", "offset", "offset", "rows", "uncertainty_rows"),
    Quantity("slit offset in micrometres", "µm", "offset", "offset", "rows", "uncertainty_rows", None),
    Quantity("tilt of the line", "degrees", "offset", "offset", "tilt_deg"),
    Quantity("galvo", "mV per row", "galvo", "galvo", "volts_per_row", "volts_per_row_uncertainty", 1e3),
    Quantity("galvo at row 0", "mV", "galvo", "galvo", "volts_at_row_zero", "volts_at_row_zero_uncertainty", 1e3),
    Quantity("residuals of the galvo map", "rows RMS", "galvo", "galvo", "rms_rows", watched=False),
    Quantity("scan lag", "µs", "lag", "galvo", "lag_s", factor=1e6),
    Quantity("bundle diameter", "px", "pair", "bundle", "diameter_px", "diameter_uncertainty_px"),
    Quantity("gain of the residual view", "", "pair", "bundle", "residual_gain", "residual_gain_uncertainty"),
    Quantity("scale", "µm per px", "pair", "optics", "um_per_px", watched=False),
    Quantity("line period", "µs", "", "optics", "line_period_s", factor=1e6, watched=False),
    Quantity("line periods per frame", "", "", "optics", "line_periods_per_frame", watched=False),
    Quantity("alignment error", "%", "pair", "quality", "alignment_error", factor=100.0),
    Quantity("alignment error, filtered", "%", "pair", "quality", "alignment_error_filtered", "", 100.0, watched=False),
)
"""Numbers of a calibration that are single values."""
