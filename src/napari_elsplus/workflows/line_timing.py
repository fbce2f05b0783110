"""The rows per frame that a calibration lacks, from the motion in a recording."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from napari_elsplus.instrument.calibration import OpticsSection
from napari_elsplus.processing.images.sectioning import Mode
from napari_elsplus.processing.tracking.methods import RegistrationTracking

if TYPE_CHECKING:
    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.workflows.sectioning import RawPairs

_LOOKED_AT: Final = 600
"""Frames from which the timing is told at most."""


def with_timing(calibration: Calibration, raw_pair: RawPairs, mode: Mode | str) -> tuple[Calibration, str]:
    """Give a calibration the rows per frame that it lacks, from the motion in a recording.

    Parameters
    ----------
    calibration : Calibration
        Returned as it is where it knows the rows per frame.
    raw_pair : RawPairs
        The recording; its first frames are tracked.
    mode : Mode or str
        Which image is tracked.

    Returns
    -------
    calibration : Calibration
        With the rows per frame, if the motion tells them.
    said : str
        What was found, in words; empty if they were known.
    """
    known = calibration.optics
    if known is not None and known.line_periods_per_frame is not None:
        return calibration, ""
    shape = raw_pair(0)[0].shape
    assumed = _with_rows(calibration, float(shape[0]))
    tracking = RegistrationTracking(assumed, (shape[0], shape[1]), Mode(mode))
    for index in range(min(len(raw_pair), _LOOKED_AT)):
        tracking.track(*raw_pair(index))
    found = tracking.line_periods_per_frame()
    if found is None:
        return (
            calibration,
            "rows per frame unknown, and the motion does not tell them: the rolling shutter is not corrected; "
            "give them with `calibrate --rows-per-frame`",
        )
    said = f"rows per frame estimated from the motion: {found.rows:.1f} +- {found.sigma:.1f}"
    return _with_rows(calibration, found.rows), said


def _with_rows(calibration: Calibration, rows: float) -> Calibration:
    optics = (calibration.optics or OpticsSection()).model_copy(update={"line_periods_per_frame": rows})
    return calibration.model_copy(update={"optics": optics})
