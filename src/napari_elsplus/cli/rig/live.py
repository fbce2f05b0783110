"""The progress bars of a live calibration."""

from __future__ import annotations

from typing import TYPE_CHECKING

from napari_elsplus.cli.options import progress

if TYPE_CHECKING:
    from napari_elsplus.processing.progress import ProgressWrapper


def calibration_progress(step: str) -> ProgressWrapper:
    """Return the progress bar of a step of the calibration."""
    return lambda numbers: progress(numbers, f"Calibrating: {step}")
