"""Add a calibration step: the read noise of the camera, from frames of the dark tube with the line parked.

``python examples/extending/calibration_step.py`` measures it on the simulated rig, with the other steps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from napari_elsplus import open_engine
from napari_elsplus.errors import MeasurementError
from napari_elsplus.processing.calibration.step import CalibrationStep, Capture, StepSummary, Target
from napari_elsplus.processing.calibration.steps import register_step


@dataclass(frozen=True)
class ReadNoise:
    """Standard deviation of a dark pixel from frame to frame, in grey levels, and its uncertainty."""

    sigma_dn: float
    uncertainty_dn: float
    frames: int


def estimate(inputs, draft):
    """Measure the read noise: the spread of each pixel over the frames, averaged over the pixels."""
    frames = np.asarray(inputs.frames, np.float32)
    if len(frames) < 2:
        raise MeasurementError(f"{len(frames)} frame shows no noise", "take at least 2 frames")
    variance = frames.var(axis=0, ddof=1)
    sigma_dn = float(np.sqrt(variance.mean()))
    spread = float(variance.std() / np.sqrt(variance.size))  # of the mean variance, one standard deviation
    return ReadNoise(sigma_dn, spread / (2 * sigma_dn) if sigma_dn else 0.0, len(frames))


def apply(draft, found):
    """Return the draft's calibration with a section of its own, which files keep."""
    section = {"sigma_dn": found.sigma_dn, "uncertainty_dn": found.uncertainty_dn}
    return draft.calibration.model_copy(update={"read_noise": section})


def summarize(found, draft, setup):
    """Summarize the read noise."""
    gain_db = setup.acquired_with.gain_db
    lines = [f"{found.frames} frames" + ("" if gain_db is None else f" at a gain of {gain_db:g} dB")]
    return StepSummary(f"{found.sigma_dn:.3f} ± {found.uncertainty_dn:.3f} grey levels", lines)


READ_NOISE = register_step(
    CalibrationStep(
        key="read_noise",
        title="read noise",
        explanation="Noise of the camera without light.",
        preparation="Probe in the dark tube.",
        target=Target.DARK_TUBE,
        capture=Capture.PARKED,
        frames=20,
        estimate=estimate,
        apply=apply,
        summarize=summarize,
        section="read_noise",
        settings=("gain_db",),
        option="dark",
        option_help="Frames of the dark tube, the line parked.",
    )
)

if __name__ == "__main__":
    with open_engine("simulated") as engine:
        print(engine.calibration.read_noise)
