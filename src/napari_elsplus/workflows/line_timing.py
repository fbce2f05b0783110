"""Compare a calibration's timing with a recording's, and estimate what it lacks from the motion."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from napari_elsplus.io.frame_times import median_period_s
from napari_elsplus.processing.images.sectioning import Mode
from napari_elsplus.processing.tracking.methods import RegistrationTracking

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np
    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.workflows.sectioning import RawPairs

MAX_PERIOD_DIFFERENCE: Final = 0.03
"""Tolerated difference of frame periods, fraction. Chosen: the correction of motion within a frame has this relative
error, 0.3 px where the probe moves 10."""
MAX_FRAMES: Final = 600
"""Frames that are tracked for the estimate at most: 2.5 s at 240 Hz; chosen, its standard deviation is reported."""


def frame_rate_note(
    calibration: Calibration,
    times_s: Sequence[float] | NDArray[np.float64] | None,
    frame_numbers: Sequence[int] | NDArray[np.int64] | None,
) -> str:
    """Return a message to the user where frames are not as far apart as the calibration's; else an empty one.

    Parameters
    ----------
    calibration : Calibration
        Its timing corrects the rolling shutter.
    times_s : sequence of float or None
        (T,) time of each frame, seconds.
    frame_numbers : sequence of int or None
        (T,) the camera's number of each frame, where gaps are lost frames; None if none were lost.
    """
    period_s = None if times_s is None else median_period_s(times_s, frame_numbers)
    expected_s = calibration.frame_period_s
    if period_s is None or expected_s is None or abs(period_s / expected_s - 1) <= MAX_PERIOD_DIFFERENCE:
        return ""
    return (
        f"the frames are {1e3 * period_s:.2f} ms apart, those of the calibration {1e3 * expected_s:.2f} ms: use one of "
        "this frame rate, since its timing corrects the rolling shutter"
    )


def with_timing(calibration: Calibration, raw_pair: RawPairs, mode: Mode | str) -> tuple[Calibration, str]:
    """Add the line periods per frame to a calibration without them, estimated from the motion in a recording.

    Parameters
    ----------
    calibration : Calibration
        Returned unchanged if it has them.
    raw_pair : RawPairs
        The recording; its first :data:`MAX_FRAMES` frames are tracked.
    mode : Mode or str
        Image type to track.

    Returns
    -------
    calibration : Calibration
        With the line periods per frame, if the motion constrains them.
    note : str
        Message to the user with the estimate; empty if the calibration had them.
    """
    known = calibration.optics
    if known is not None and known.line_periods_per_frame is not None:
        return calibration, ""
    shape = raw_pair(0)[0].shape
    assumed = calibration.with_optics(line_periods_per_frame=float(shape[0]))
    tracking = RegistrationTracking(assumed, (shape[0], shape[1]), Mode(mode))
    for index in range(min(len(raw_pair), MAX_FRAMES)):
        tracking.skip(raw_pair.lost_before(index))
        tracking.track(*raw_pair(index))
    found = tracking.line_periods_per_frame()
    if found is None:
        return (
            calibration,
            "rows per frame unknown, and the motion does not constrain them: the rolling shutter is not corrected; "
            "give them with `calibrate --rows-per-frame`",
        )
    note = f"rows per frame estimated from the motion: {found.rows:.1f} +- {found.sigma:.1f}"
    return calibration.with_optics(line_periods_per_frame=found.rows), note
