"""Recommend slit and offset for a depth: the best suppression of haze there that keeps enough of the signal."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from math import isfinite
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from scipy.optimize import brentq

from napari_elsplus.errors import InputError
from napari_elsplus.instrument.arguments import require_calibration
from napari_elsplus.instrument.optics import BUNDLE_UM
from napari_elsplus.processing.images.sectioning import line_offset_px
from napari_elsplus.simulation.model.axial_response import LineModel, model_drop_offs, model_response, signal_kept
from napari_elsplus.workflows.recommendation.line_estimate import MODEL_SIGMA, LineEstimate, calibrated_line

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from napari_elsplus.instrument.calibration import Calibration

SLITS_ROWS: Final = (1, 2, 3, 4, 5, 6, 8)
"""Slits that are compared, rows; chosen: the paper's are 3 rows and more."""
MAX_OFFSET_SHARE: Final = 0.25
"""Largest offset, of the bundle's diameter; chosen: a third of the field is then clipped."""
WIDER_SLIT_COST: Final = 0.1
"""Relative loss of suppression up to which a wider slit is taken for its light; chosen."""
COMPARED_OFFSETS_UM: Final = (12.0, 80.0)
"""Of the predictions that were compared with scans of depths; see the page on calibration."""
DRAWS: Final = 64
"""Lines drawn within the uncertainties; derived: standard deviations are then known to 9 %."""


@dataclass(frozen=True, slots=True)
class Prediction:
    """Predicted sectioning of ELS+ at a setting.

    Parameters
    ----------
    signal_kept : float
        ELS+ over LS of a plate in contact.
    drop_3db_um, drop_10db_um : float
        Distances at which ELS+ of a plate has fallen to a half and to a tenth.
    haze : float
        ELS+ of a plate at the depth in question over that in contact.
    """

    signal_kept: float
    drop_3db_um: float
    drop_10db_um: float
    haze: float


@dataclass(frozen=True, slots=True)
class Recommendation:
    """Slit and offset for a depth, and what to expect; each with one standard deviation.

    Parameters
    ----------
    depth_um, keep : float
        What was asked for: depth of the haze, and least fraction of the signal.
    slit_rows, offset_rows : float
        The setting, camera rows; the offset with the sign of the calibrated one.
    expected, present : Prediction
        At that setting, and at the calibrated offset.
    sigmas : dict of str to float
        Standard deviations of slit, offset and the expected values.
    assumed : tuple of str
        Parameters of the line that the calibration does not contain.
    notes : tuple of str
        Messages to the user: what is of the model, and what lies beyond what was measured.
    """

    depth_um: float
    keep: float
    slit_rows: float
    offset_rows: float
    expected: Prediction
    present: Prediction
    sigmas: dict[str, float]
    assumed: tuple[str, ...]
    notes: tuple[str, ...] = ()

    def content(self) -> dict[str, Any]:
        """Return all values, ready for JSON: each beside its ``_sigma``."""
        values = {"slit_rows": self.slit_rows, "offset_rows": self.offset_rows, **asdict(self.expected)}
        pairs = {key: entry for name, value in values.items()
                 for key, entry in ((name, value), (f"{name}_sigma", self.sigmas[name]))}  # fmt: skip
        asked = {"depth_um": self.depth_um, "keep": self.keep}
        return {
            **asked,
            **pairs,
            "present": asdict(self.present),
            "assumed": list(self.assumed),
            "notes": list(self.notes),
        }


def recommend(
    calibration: Calibration, depth_um: float, keep: float = 0.95, plate: Mapping[str, Any] | None = None
) -> Recommendation:
    """Return the slit and the offset that suppress haze from a depth best while enough of the signal is kept.

    ELS+ keeps more the larger the offset is, and sections better the smaller it is: the offset is the smallest that
    keeps enough, and the slit the widest that costs little.

    Parameters
    ----------
    calibration : Calibration
        With the line's core and halo (`calibrate --line`) and the scale.
    depth_um : float
        Distance of the haze from the probe's face.
    keep : float
        Least fraction of the in-focus signal that ELS+ keeps.
    plate : mapping, optional
        Content of the file that ``axial`` wrote, from which the spread and the gap of a plate are fitted.

    Raises
    ------
    CalibrationError
        If the calibration does not contain the line.
    InputError
        If the depth or the fraction is impossible, or no offset keeps as much.
    """
    require_calibration(calibration)
    if not (isfinite(depth_um) and depth_um > 0):
        raise InputError(f"the depth is {depth_um:g} um", "give a positive number")
    if not 0 < keep < 1:
        raise InputError(f"the fraction to keep is {keep:g}", "give a number between 0 and 1")
    estimate = calibrated_line(calibration, plate)
    um, bundle = calibration.measured_um_per_px, calibration.bundle
    reach_um = MAX_OFFSET_SHARE * (bundle.diameter_px * um if bundle is not None else BUNDLE_UM)
    slit_rows, offset_um = _best(estimate.line, um, depth_um, keep, reach_um)
    drawn = list(estimate.draws(DRAWS))
    expected = predict_line(estimate.line, offset_um, slit_rows * um, depth_um)
    offsets = [smallest_offset_um(line, slit_rows * um, keep, reach_um) or reach_um for line in drawn]
    slits = [_best(line, um, depth_um, keep, reach_um, refuse=False)[0] for line in drawn[:16]]
    sigmas = prediction_sigmas(drawn, expected, offset_um, slit_rows * um, depth_um)
    sigmas |= {"slit_rows": float(np.std(slits)), "offset_rows": float(np.std(offsets) / um)}
    present_px = line_offset_px(calibration)
    sign = -1.0 if present_px < 0 else 1.0
    present = predict_line(estimate.line, abs(present_px) * um, calibration.slit_rows * um, depth_um)
    return Recommendation(
        depth_um, keep, float(slit_rows), sign * offset_um / um, expected, present, sigmas, estimate.assumed,
        tuple(_notes(estimate, expected, offset_um, depth_um)),
    )  # fmt: skip


def _notes(estimate: LineEstimate, expected: Prediction, offset_um: float, depth_um: float) -> Iterator[str]:
    """Yield what is of the model, and what lies beyond what was measured."""
    if estimate.assumed:
        yield "spread and gap are those of the model: measure a plate with `axial` and give it with --plate"
    depths = {"haze": depth_um, "3 dB": expected.drop_3db_um, "10 dB": expected.drop_10db_um}
    beyond = [f"{name} at {at_um:.4g} um" for name, at_um in depths.items() if at_um > estimate.measured_to_um]
    if beyond:
        measured = "states of the model were" if estimate.assumed else "plate was"
        yield (
            f"{' and '.join(beyond)}: extrapolated beyond the {estimate.measured_to_um:.0f} um to which the {measured} "
            "measured: measure a plate as deep with `axial`, as far as the bundle's rim lets it"
        )
    low_um, high_um = COMPARED_OFFSETS_UM
    if not low_um <= offset_um <= high_um:
        yield (
            f"an offset of {offset_um:.0f} um is extrapolated beyond the {low_um:g} to {high_um:g} um at which "
            "predictions were compared with scans: measure `axial` there"
        )


def predict_line(line: LineModel, offset_um: float, slit_um: float, depth_um: float) -> Prediction:
    """Return what ELS+ does with a line at a setting.

    Parameters
    ----------
    line : LineModel
        The line.
    offset_um, slit_um : float
        The setting, micrometres at the bundle.
    depth_um : float
        Depth of the haze.
    """
    drops = model_drop_offs(offset_um=offset_um, slit_um=slit_um, line=line)
    return Prediction(
        signal_kept(offset_um=offset_um, slit_um=slit_um, line=line),
        drops.drop_3db_um,
        drops.drop_10db_um,
        _haze(line, offset_um, slit_um, depth_um),
    )


def prediction_sigmas(
    drawn: list[LineModel], expected: Prediction, offset_um: float, slit_um: float, depth_um: float
) -> dict[str, float]:
    """Return one standard deviation of each predicted value.

    Parameters
    ----------
    drawn : list of LineModel
        Lines within the uncertainties.
    expected : Prediction
        The prediction.
    offset_um, slit_um, depth_um : float
        As of :func:`predict_line`.
    """
    names = tuple(asdict(expected))
    table = np.array(
        [[getattr(predict_line(line, offset_um, slit_um, depth_um), name) for name in names] for line in drawn]
    )
    model = {"signal_kept": 0.005, "haze": 0.01}
    return {
        name: float(np.hypot(table[:, k].std(), model.get(name, MODEL_SIGMA * getattr(expected, name))))
        for k, name in enumerate(names)
    }


def smallest_offset_um(line: LineModel, slit_um: float, keep: float, reach_um: float) -> float | None:
    """Return the smallest offset at which ELS+ keeps a fraction of the signal; None if none up to `reach_um` does.

    Parameters
    ----------
    line : LineModel
        The line.
    slit_um : float
        Slit width, micrometres.
    keep : float
        The fraction.
    reach_um : float
        Largest offset, micrometres.
    """

    def missing(offset_um: float) -> float:
        return signal_kept(offset_um=offset_um, slit_um=slit_um, line=line) - keep

    if missing(reach_um) < 0:
        return None
    return float(brentq(missing, 0.01, reach_um)) if missing(0.01) < 0 else 0.01


def _best(
    line: LineModel, um: float, depth_um: float, keep: float, reach_um: float, *, refuse: bool = True
) -> tuple[int, float]:
    """Return slit, rows, and offset, micrometres."""
    found = {rows: smallest_offset_um(line, rows * um, keep, reach_um) for rows in SLITS_ROWS}
    offsets = {rows: offset_um for rows, offset_um in found.items() if offset_um is not None}
    if not offsets:
        if refuse:
            most = max(signal_kept(offset_um=reach_um, slit_um=rows * um, line=line) for rows in SLITS_ROWS)
            raise InputError(
                f"no offset up to {reach_um:.0f} um keeps {100 * keep:g} % of the signal",
                f"at most {100 * most:.4g} % are kept: ask for less",
            )
        return SLITS_ROWS[0], reach_um
    haze = {rows: _haze(line, offset_um, rows * um, depth_um) for rows, offset_um in offsets.items()}
    least = min(haze.values())
    slit_rows = max(rows for rows, left in haze.items() if left <= least + WIDER_SLIT_COST * abs(least))
    return slit_rows, offsets[slit_rows]


def _haze(line: LineModel, offset_um: float, slit_um: float, depth_um: float) -> float:
    els = model_response([0.0, depth_um], offset_um=offset_um, slit_um=slit_um, line=line).els
    return float(els[1] / els[0])
