"""The laser line as calibrated, with what the calibration does not contain taken from a measured plate or the model."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from scipy.optimize import least_squares

from napari_elsplus.errors import CalibrationError, InputError
from napari_elsplus.instrument.optics import CORE_PITCH_UM
from napari_elsplus.simulation.model.axial_response import LINE_MODELS, LineModel, line_response

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import Calibration

SPOT_UM: Final = 0.3 * CORE_PITCH_UM
"""Standard deviation of a core's spot, micrometres, by which the camera widens the line; assumed, as of the simulated
bundle: 0.3 core pitches."""
SPREAD_SIGMA: Final = 0.01
"""Uncertainty of the spread that is taken from the model; chosen, the difference between the paper's two states."""
GAP_SIGMA_UM: Final = 3.0
"""Uncertainty of the gap that is taken from the model, micrometres; chosen, half of that difference."""
MODEL_SIGMA: Final = 0.02
"""Relative uncertainty of drop-offs from what the model leaves out, the rim of the bundle above all; measured on
simulated scans, where it is 0.5 % and noise about as much."""
MAX_PLATE_UM: Final = 300.0
"""Depth to which a measured plate is fitted, micrometres; chosen: the rim of the bundle cuts light beyond."""
MAX_LS: Final = 10.0
"""Factor within which the largest value of a plate's LS curve lies about its value in contact, 1; chosen."""
AXIAL_FILE: Final = "name the JSON that `axial` wrote"
_FIELDS: Final = ("core_um", "halo_share", "halo_um", "spread", "gap_um")


@dataclass(frozen=True, slots=True)
class LineEstimate:
    """A line model with the uncertainties of its parameters.

    Parameters
    ----------
    line : LineModel
        The line.
    sigmas : dict of str to float
        One standard deviation of each of its parameters.
    assumed : tuple of str
        Parameters that were not measured.
    measured_to_um : float
        Depth up to which the spread was measured: on the plate, or by those who measured the model's.
    """

    line: LineModel
    sigmas: dict[str, float]
    assumed: tuple[str, ...]
    measured_to_um: float = MAX_PLATE_UM

    def draws(self, count: int) -> Iterator[LineModel]:
        """Yield lines drawn at random within the uncertainties.

        Parameters
        ----------
        count : int
            How many.
        """
        random = np.random.default_rng(0)
        for _ in range(count):
            drawn = {name: getattr(self.line, name) + self.sigmas[name] * random.normal() for name in _FIELDS}
            core_um = max(drawn["core_um"], 0.1)
            yield LineModel(
                core_um=core_um,
                halo_share=float(np.clip(drawn["halo_share"], 0.0, 1.0)),
                halo_um=max(drawn["halo_um"], 1.1 * core_um),
                spread=max(drawn["spread"], 0.02),
                gap_um=max(drawn["gap_um"], 0.0),
            )


def calibrated_line(calibration: Calibration, plate: Mapping[str, Any] | None = None) -> LineEstimate:
    """Return the line of a calibration; its spread and gap from a measured plate, or of the nearest modelled state.

    Parameters
    ----------
    calibration : Calibration
        With the line's core and halo in its offset section, and the scale.
    plate : mapping, optional
        Content of the file that ``axial`` wrote for a scan of depths on the same rig.

    Raises
    ------
    CalibrationError
        If the calibration lacks the offset, the line's parts or the scale.
    InputError
        If the plate's content is incomplete.
    """
    offset, um = calibration.measured_offset, calibration.measured_um_per_px
    if offset.core_rows is None or offset.halo_rows is None or offset.halo_share is None:
        raise CalibrationError(
            "the calibration has no core and halo of the line", "measure them with `calibrate --line`, near the middle"
        )
    line = line_of_parts(offset.core_rows * um, offset.halo_rows * um, offset.halo_share)
    sigmas = {
        "core_um": max((offset.core_uncertainty_rows or 0.0) * um, 0.05 * line.core_um),  # the spot is assumed
        "halo_share": max(offset.halo_share_uncertainty or 0.0, 0.01),
        "halo_um": max((offset.halo_uncertainty_rows or 0.0) * um, 0.03 * line.halo_um),
        "spread": SPREAD_SIGMA,
        "gap_um": GAP_SIGMA_UM,
    }
    estimate = LineEstimate(line, sigmas, ("spread", "gap_um"))
    return estimate if plate is None else _fitted(estimate, plate, calibration.slit_rows * um)


def line_of_parts(core_um: float, halo_um: float, halo_share: float) -> LineModel:
    """Return the line model of a measured core and halo, with spread and gap of the modelled state of nearest core.

    Parameters
    ----------
    core_um, halo_um : float
        Standard deviations as the camera sees them, micrometres.
    halo_share : float
        Share of the light in the halo.
    """
    narrow_um = float(np.sqrt(max(core_um**2 - SPOT_UM**2, (0.2 * core_um) ** 2)))
    nearest = min(LINE_MODELS.values(), key=lambda line: abs(np.log(line.core_um / narrow_um)))
    return replace(nearest, core_um=narrow_um, halo_share=halo_share, halo_um=halo_um)


def _fitted(estimate: LineEstimate, plate: Mapping[str, Any], slit_um: float) -> LineEstimate:
    """Return the estimate with spread and gap fitted to the LS curve of a plate."""
    try:
        depth_um = np.asarray(plate["depth_um"], np.float64) - float(plate.get("contact_um", 0.0))
        ls = np.asarray(plate["profiles"]["ls"], np.float64)
        used = np.flatnonzero((depth_um >= 0) & (depth_um <= MAX_PLATE_UM) & np.isfinite(ls))
        depth_um, ls = depth_um[used], ls[used]
    except (KeyError, IndexError, TypeError, ValueError):
        raise InputError("the plate's file has no depths or no LS profile at them", AXIAL_FILE) from None
    if len(ls) < 5:
        raise InputError(f"the plate was measured at {len(ls)} depths up to {MAX_PLATE_UM:g} um", "5 are needed")
    if not 1 / MAX_LS < ls.max() < MAX_LS:
        raise InputError(f"the plate's file has no LS curve, its largest value is {ls.max():g}", AXIAL_FILE)

    def misfit(parameters: NDArray[np.float64]) -> NDArray[np.float64]:
        spread, gap_um, level = parameters
        line = replace(estimate.line, spread=spread, gap_um=gap_um)
        return np.asarray(level * line_response(depth_um + gap_um, 0.0, slit_um, line) - ls)

    start = estimate.line
    level = float(ls.max() / line_response(start.gap_um, 0.0, slit_um, start))
    bounds = ([0.02, 0.0, 0.1 * level], [2.0, 100.0, 10 * level])
    found = least_squares(misfit, [start.spread, start.gap_um, level], bounds=bounds, x_scale=[0.1, 10.0, level])
    covariance = np.linalg.pinv(found.jac.T @ found.jac) * np.mean(found.fun**2)
    sigmas = estimate.sigmas | {
        name: float(np.hypot(np.sqrt(covariance[k, k]), 0.01 * found.x[k]))
        for k, name in enumerate(("spread", "gap_um"))
    }
    line = replace(start, spread=float(found.x[0]), gap_um=float(found.x[1]))
    return LineEstimate(line, sigmas, (), float(depth_um.max()))
