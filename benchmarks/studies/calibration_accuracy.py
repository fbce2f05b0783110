"""Accuracy of calibrations, and of their stated uncertainties, over many random rigs."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.errors import ElsPlusError
from napari_elsplus.instrument.optics import LINE_RATE_HZ
from napari_elsplus.processing.calibration.calibrate import measure
from napari_elsplus.processing.calibration.scan.lag import measure_lag

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from benchmarks.rigs.random_rigs import Rig
    from napari_elsplus.processing.calibration.bundle.pair import BundlePair
    from napari_elsplus.processing.calibration.draft import Draft

    Floats = NDArray[np.float64]

LINE_AT_ROW: Final = 1.3
"""Row of the standing line about the left centre."""
RIM: Final = 24


@dataclass(frozen=True, slots=True)
class Quantity:
    """One number of a calibration.

    Parameters
    ----------
    name, unit : str
        What it is called in tables.
    bar : float
        Largest RMS error that is good enough.
    """

    name: str
    unit: str
    bar: float


OFFSET: Final = Quantity("slit offset", "rows", 0.03)
TILT: Final = Quantity("line tilt", "deg", 0.1)
SLOPE: Final = Quantity("galvo slope", "%", 0.05)
INTERCEPT: Final = Quantity("galvo intercept", "rows", 0.2)
CENTRE: Final = Quantity("bundle centre, per axis", "px", 0.1)
DIAMETER: Final = Quantity("bundle diameter", "%", 0.5)
ALIGNMENT: Final = Quantity("pair alignment at the rim, per axis", "px", 0.2)
GAIN: Final = Quantity("gain of the right view", "%", 0.5)
LAG: Final = Quantity("scan lag", "rows", 0.3)
QUANTITIES: Final = (OFFSET, TILT, SLOPE, INTERCEPT, CENTRE, DIAMETER, ALIGNMENT, GAIN, LAG)


Errors = dict[Quantity, list[tuple[float, float]]]
"""Error and stated standard deviation of each measurement."""


@dataclass(frozen=True, slots=True)
class Accuracy:
    """Errors of one quantity over many rigs.

    Parameters
    ----------
    quantity : Quantity
        Which.
    errors, stated : numpy.ndarray
        Measured minus true, and the standard deviation that the software states; shape (measurements,).
    """

    quantity: Quantity
    errors: Floats
    stated: Floats

    @property
    def rms(self) -> float:
        """Root mean square error."""
        return float(np.sqrt(np.mean(np.square(self.errors))))

    @property
    def largest(self) -> float:
        """Largest error."""
        return float(np.abs(self.errors).max())

    def within(self, sigmas: float) -> float:
        """Share of measurements whose error is below so many stated standard deviations."""
        return float(np.mean(np.abs(self.errors) <= sigmas * self.stated))


@dataclass(frozen=True, slots=True)
class Survey:
    """Results of calibrating many rigs.

    Parameters
    ----------
    accuracies : dict
        By quantity.
    rigs : int
        Rigs calibrated.
    refused : list of str
        What the software said of rigs that it refused.
    """

    accuracies: Mapping[Quantity, Accuracy]
    rigs: int
    refused: list[str]


def survey(rigs: Sequence[Rig], voltages: int = 400, processes: int = 1) -> Survey:
    """Calibrate rigs and compare with their truth.

    Parameters
    ----------
    rigs : sequence of Rig
        What to calibrate.
    voltages : int
        Length of the galvo's sweep; 0: no sweep.
    processes : int
        How many rigs are calibrated at once.

    Returns
    -------
    Survey
    """
    once = partial(_calibrated, voltages=voltages)
    if processes > 1:
        with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
            outcomes = list(pool.map(once, rigs))
    else:
        outcomes = [once(rig) for rig in rigs]
    refused = [outcome for outcome in outcomes if isinstance(outcome, str)]
    measured = [outcome for outcome in outcomes if not isinstance(outcome, str)]
    accuracies = {}
    for quantity in QUANTITIES:
        pairs = [pair for errors in measured for pair in errors.get(quantity, [])]
        if pairs:
            accuracies[quantity] = Accuracy(quantity, *np.array(pairs, np.float64).T)
    return Survey(accuracies, len(rigs), refused)


def _calibrated(rig: Rig, voltages: int) -> Errors | str:
    volts = rig.volts(voltages) if voltages else None
    try:
        found = measure(
            line=rig.line(row=LINE_AT_ROW),
            sweep=None if volts is None else rig.sweep(volts),
            volts=volts,
            bundle=rig.bundle(),
            background=rig.background(10),
        )
        lag = measure_lag(lambda lead_s, shift: rig.scanned_signal(lead_s * LINE_RATE_HZ + shift), 1 / LINE_RATE_HZ)
    except ElsPlusError as error:
        return str(error)
    late = lag.lag_s * LINE_RATE_HZ - rig.lag_rows
    return errors_of(found, rig) | {LAG: [(late, lag.uncertainty_s * LINE_RATE_HZ)]}


def errors_of(found: Draft, rig: Rig) -> Errors:
    """Error and stated uncertainty of everything that was measured."""
    errors: Errors = {}
    if found.offset is not None:
        offset = found.offset
        errors[OFFSET] = [(offset.rows - rig.offset_rows(0.0), offset.uncertainty_rows)]
        errors[TILT] = [(offset.confocal.tilt_deg - rig.tilt_deg, offset.confocal.tilt_uncertainty_deg)]
    if found.galvo is not None:
        galvo, per_row = found.galvo, abs(rig.volts_per_row)
        steeper = galvo.volts_per_row / rig.volts_per_row - 1
        errors[SLOPE] = [(100 * steeper, 100 * galvo.volts_per_row_uncertainty / per_row)]
        higher = (galvo.volts_at_row_zero - rig.volts_at_row_zero) / per_row
        errors[INTERCEPT] = [(higher, galvo.volts_at_row_zero_uncertainty / per_row)]
    if found.pair is not None:
        errors |= _errors_of_pair(found.pair, rig)
    return errors


def _errors_of_pair(pair: BundlePair, rig: Rig) -> Errors:
    alignment = pair.alignment
    angle = 2 * np.pi * (np.random.default_rng(rig.seed).integers(RIM) / RIM)
    rim = np.array(rig.right) + 0.45 * rig.diameter_px * np.array([np.sin(angle), np.cos(angle)])
    misplaced = (alignment.residual_to_confocal - rig.residual_to_confocal) @ (*rim, 1.0)
    wider = pair.confocal.diameter_px / rig.diameter_px - 1
    return {
        CENTRE: [
            (float(error), disc.centre_uncertainty_px)
            for disc, centre in ((pair.confocal, rig.left), (pair.residual, rig.right))
            for error in np.subtract(disc.centre, centre)
        ],
        DIAMETER: [(100 * wider, 100 * pair.confocal.diameter_uncertainty_px / rig.diameter_px)],
        ALIGNMENT: [(float(error), alignment.uncertainty_px) for error in misplaced],
        GAIN: [(100 * (alignment.gain / rig.gain - 1), 100 * alignment.gain_uncertainty / rig.gain)],
    }
