"""LS, ELSA and ELS+ of one moment of a recording."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING

import numpy as np

from napari_elsplus.errors import InputError, MeasurementError
from napari_elsplus.instrument.arguments import require_calibration, require_frames
from napari_elsplus.processing.analysis.image_quality import USED_DIAMETER
from napari_elsplus.processing.calibration.core_agreement import agreement_note
from napari_elsplus.processing.images.modes import COMPARED_MODES, frames_in_turn
from napari_elsplus.processing.images.sectioning import Mode, disc
from napari_elsplus.workflows.pictures.comparison import ComparisonFigure, scaled_images
from napari_elsplus.workflows.sectioning import SectionedImages

if TYPE_CHECKING:
    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.processing.images.sectioning import Frames


def compare(raw: Frames, calibration: Calibration, frame: int = 0) -> ComparisonFigure:
    """Return LS, ELSA and ELS+ images of one raw frame; ELSA takes its residual from the next frame.

    Parameters
    ----------
    raw : Frames
        Raw frames (rows, cols).
    calibration : Calibration
        Of the rig that made them.
    frame : int
        Index of the frame; not the last, since ELSA needs the one after it.

    Raises
    ------
    InputError
        If the frame, or the one after it, does not exist.
    CalibrationError
        If the calibration does not fit the recording.
    MeasurementError
        If the frame shows no light.
    """
    require_frames(raw)
    require_calibration(calibration)
    if not 0 <= frame < len(raw) - 1:
        raise InputError(
            f"frame {frame} and the one after it are needed, the recording has {len(raw)} frames",
            f"choose a frame from 0 to {len(raw) - 2}" if len(raw) > 1 else "record at least two",
        )
    images = {mode: SectionedImages(frames_in_turn(raw, mode), calibration, mode)[frame] for mode in COMPARED_MODES}
    if note := agreement_note(raw, calibration):
        warnings.warn(note, stacklevel=2)
    inside = disc(len(images[Mode.LS]), USED_DIAMETER * calibration.measured_bundle.diameter_px)
    if dark := [mode.label for mode in (Mode.LS, Mode.ELS) if not np.nanmax(images[mode][inside]) > 0]:
        raise MeasurementError(
            f"frame {frame} shows no light in {', '.join(dark)}",
            "is the laser on, and does the background belong to this recording?",
        )
    return ComparisonFigure(scaled_images(images, inside), inside, um_per_px=calibration.um_per_px)
