"""Figures that the software saves itself, of the simulated instrument: a comparison, and a calibration report."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from napari_elsplus.workflows.calibration import calibrate
from napari_elsplus.workflows.calibration_report.report import save_calibration_report
from napari_elsplus.workflows.comparison import compare
from napari_elsplus.workflows.simulated import simulate_calibration, simulate_recording

if TYPE_CHECKING:
    from pathlib import Path

SEED: Final = 1
"""Of specimen, motion and noise; chosen, that of the sample recording."""
BUNDLE_UM: Final = 620.0
"""Diameter of the simulated bundle, micrometres."""
QUICK_STEP: Final = 8
"""Every so many frames of the calibration's recordings are used in a quick run."""


def make(images: Path, *, quick: bool = False) -> None:
    """Save the comparison as ``figure-comparison.png`` and the report as ``calibration-report.pdf``.

    Parameters
    ----------
    images : pathlib.Path
        Folder.
    quick : bool
        Few frames: a check that it runs.
    """
    frames = simulate_recording(frames=3, seed=SEED)
    compare(frames, frames.calibration, 1).save(images / "figure-comparison.png", force=True)
    taken, step = simulate_calibration(seed=SEED), QUICK_STEP if quick else 1
    draft = calibrate(
        line=list(taken.line)[::step],
        sweep=list(taken.sweep)[::step],
        volts=taken.volts[::step],
        bundle=list(taken.bundle)[::step],
        background=list(taken.background)[::step],
        bundle_um=BUNDLE_UM,
    )
    save_calibration_report(draft, images / "calibration-report.pdf", force=True)
