"""Explanation of a calibration step, and the user's next action in the Calibration panel."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from napari_elsplus.processing.calibration.step import StepState
from napari_elsplus.processing.calibration.steps import find_step
from napari_elsplus.widgets.calibration.session import undone_steps
from napari_elsplus.widgets.shared.panel import next_hint

if TYPE_CHECKING:
    from napari_elsplus.processing.calibration.draft import Draft
    from napari_elsplus.processing.calibration.step import CalibrationStep


def explanation(step: CalibrationStep[Any], *, simulated: bool, action: str) -> str:
    """Return rich text: what a step measures, what the user does for it, and the next action.

    Parameters
    ----------
    step : CalibrationStep
        The displayed step.
    simulated : bool
        The simulated rig is connected.
    action : str
        The next action; empty for none.
    """
    unattended = " The simulated rig does this by itself." if simulated else ""
    lines = [step.explanation, f"<i>{step.preparation}{unattended}</i>", next_hint(action)]
    return "<br>".join(line for line in lines if line)


def next_action(key: str, draft: Draft, *, connected: bool, candidate: bool, saved: bool) -> str:
    """Return the next action; empty where nothing is left to do.

    Parameters
    ----------
    key : str
        Of the displayed step.
    draft : Draft
        Results accepted so far.
    connected, candidate, saved : bool
        A rig is connected; a result is not accepted yet; the accepted results are in a file.
    """
    if candidate:
        return "press Accept, or Discard."
    shown = find_step(key)
    if shown.state(draft)[0] is StepState.DONE:
        undone = undone_steps(draft, live=connected)
        if undone:
            return f"press {undone[0].title} above."
        return "" if saved else "press Save..."
    recorded = "press From file..., or drop its recording here" if shown.option else ""
    if connected:
        return f"{shown.missing(draft) or 'press Measure'}."
    return f"press Connect; or {recorded}." if recorded else "press Connect: this step is measured live."
