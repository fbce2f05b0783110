"""Axial response of a scan of depths, with the depths and the calibration that lie beside its file."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING

from napari_elsplus.errors import CalibrationError, InputError
from napari_elsplus.instrument.arguments import require_calibration, require_frames
from napari_elsplus.io import beside, existing_beside, read_depths_um
from napari_elsplus.processing.axial.axial_response import AxialResponse, axial_response
from napari_elsplus.processing.axial.profiles import axial_profiles
from napari_elsplus.processing.calibration.core_agreement import agreement_note
from napari_elsplus.processing.progress import without_display

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.processing.images.sectioning import Frames
    from napari_elsplus.processing.progress import Progress


def measure_axial_response(
    scan: Frames,
    calibration: Calibration | None = None,
    depth_um: Sequence[float] | NDArray[np.float64] | None = None,
    *,
    progress: Progress = without_display,
) -> AxialResponse:
    """Measure the 3 dB and 10 dB drop-offs of LS and ELS+ and the in-focus signal kept, from a scan of depths.

    Parameters
    ----------
    scan : Frames
        Raw frames (rows, cols) of a uniform plate, one for each depth: an array, a list, or an open recording.
    calibration : Calibration, optional
        Needs the bundle section and the scale; by default the one in or beside the recording.
    depth_um : sequence of float, optional
        (T,) depth of each frame; by default ``NAME.depths.csv`` or ``depths.csv`` beside the recording.
    progress : Progress
        Wraps the frames' numbers.

    Returns
    -------
    AxialResponse
        Normalised curves, and distances from contact in micrometres with their standard deviations.

    Raises
    ------
    InputError
        If the depths are unknown, or not one for each frame.
    CalibrationError
        If there is no calibration, or it does not fit the frames.
    MeasurementError
        If the scan is saturated, shows no signal in contact, or none that falls beyond it.

    References
    ----------
    .. [1] A. D. Thrapp, M. R. Hughes, J. Biomed. Opt. 26 (2021), Sec. 3.1.
    """
    require_frames(scan)
    path: Path | None = getattr(scan, "path", None)
    name = "the scan" if path is None else path.name
    known = getattr(scan, "calibration", None) if calibration is None else calibration
    if known is None:
        raise CalibrationError(f"there is no calibration in or beside {name}", "name one with -c")
    require_calibration(known)
    depths = _depths_beside(path) if depth_um is None else depth_um
    if len(depths) != len(scan):
        raise InputError(f"{len(depths)} depths for {len(scan)} frames", "give a line per frame")
    profiles = axial_profiles(scan, known, depths_um=depths, progress=lambda numbers: progress(numbers, "depths"))
    if note := agreement_note(scan, known):  # a scan that is refused has a message of its own
        warnings.warn(note, stacklevel=2)
    return axial_response(depths, *profiles)


def _depths_beside(scan: Path | None) -> NDArray[np.float64]:
    if scan is None:
        raise InputError("the depths of the scan are unknown", "give depth_um, a number per frame")
    own = beside(scan, ".depths.csv")
    path = existing_beside(scan, ".depths.csv") or own.with_name("depths.csv")
    if path.is_file():
        return read_depths_um(path)
    raise InputError(f"there is no {own.name} beside the scan", "name one with --depths")
