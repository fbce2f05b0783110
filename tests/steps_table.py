"""The calibration's steps as the documentation lists them."""

from __future__ import annotations

from napari_elsplus.processing.calibration.steps import calibration_steps


def steps_table() -> str:
    """Return the steps as a Markdown table, for the documentation."""
    rows = ["| step | at the microscope | frames | measures | recorded frames |", "|---|---|---|---|---|"]
    for number, step in enumerate(calibration_steps(), 1):
        taken = f"{step.frames}, {step.capture}" if step.frames > 1 else step.capture.value
        option = f"`--{step.option}`" if step.option else ""
        rows.append(f"| {number} {step.title} | {step.preparation} | {taken} | {step.explanation} | {option} |")
    return "\n".join(rows)
