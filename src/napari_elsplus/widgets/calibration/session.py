"""Results that were accepted in the Calibration panel, and their history for undo."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

from napari_elsplus.processing.calibration.draft import Draft
from napari_elsplus.processing.calibration.step import StepState
from napari_elsplus.processing.calibration.steps import calibration_steps, find_step

if TYPE_CHECKING:
    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.processing.calibration.draft import Setup
    from napari_elsplus.processing.calibration.step import CalibrationStep
    from napari_elsplus.viewing.calibration_script import MeasurementSource
    from napari_elsplus.workflows.calibration_report.picture import Picture


class ShownResult(NamedTuple):
    """Result of a step, its setup, its picture, and the source of its frames."""

    found: Any
    setup: Setup
    picture: Picture
    source: MeasurementSource


def undone_steps(draft: Draft, *, live: bool) -> list[CalibrationStep[Any]]:
    """Return the steps that are missing or stale.

    Parameters
    ----------
    draft : Draft
        Results accepted so far.
    live : bool
        A rig is connected; otherwise those that are only measured live are left out.
    """
    possible = [step for step in calibration_steps() if live or step.option]
    return [step for step in possible if step.state(draft)[0] is not StepState.DONE]


class CalibrationSession:
    """A calibration in the making.

    Attributes
    ----------
    draft : Draft
        Accepted results.
    candidate : ShownResult or None
        Newest result, neither accepted nor discarded yet.
    """

    def __init__(self) -> None:
        self.draft = Draft()
        self.candidate: ShownResult | None = None
        self._accepted: dict[str, ShownResult] = {}
        self._past: list[tuple[Draft, dict[str, ShownResult]]] = []

    @property
    def past(self) -> bool:
        """True if a change can be undone."""
        return bool(self._past)

    @property
    def sources(self) -> list[MeasurementSource]:
        """Sources of the accepted results, in the order in which they were accepted."""
        return [shown.source for shown in self._accepted.values()]

    def shown(self, key: str) -> ShownResult | None:
        """Return the candidate, or else the accepted result of the step with a key."""
        return self.candidate or self._accepted.get(key)

    def accept(self) -> bool:
        """Accept the candidate into the draft; return True if there was one."""
        candidate = self.candidate
        if candidate is None:
            return False
        step = candidate.source.step
        draft = find_step(step).accept(self.draft, candidate.found, candidate.setup)
        self._past.append((self.draft, dict(self._accepted)))
        self._accepted.pop(step, None)  # the order in which steps were accepted is the script's
        self._accepted[step] = candidate
        self.draft, self.candidate = draft, None
        return True

    def next_undone(self, key: str, *, live: bool) -> str:
        """Return the key of the next step after that with a key that is to be measured; the same if none is.

        Parameters
        ----------
        key : str
            Of a step.
        live : bool
            A rig is connected.
        """
        keys = [step.key for step in calibration_steps()]
        at = keys.index(key)
        undone = [keys.index(step.key) for step in undone_steps(self.draft, live=live)]
        return keys[next((index for index in undone if index >= at), next(iter(undone), at))]

    def undo(self) -> bool:
        """Restore the draft before its last change; return True if there was one."""
        if not self._past:
            return False
        self.candidate = None
        self.draft, self._accepted = self._past.pop()
        return True

    def begin_with(self, calibration: Calibration) -> None:
        """Continue with a calibration that was not made here."""
        self._past.append((self.draft, dict(self._accepted)))
        self.candidate, self._accepted = None, {}
        bundle, um_per_px = calibration.bundle, calibration.um_per_px
        known_um = None if bundle is None or um_per_px is None else um_per_px * bundle.diameter_px
        self.draft = Draft(calibration, bundle_um=self.draft.bundle_um if bundle is None else known_um)

    def change(self, draft: Draft) -> None:
        """Replace the draft by one of the same results with other optics."""
        self._past.append((self.draft, dict(self._accepted)))
        self.draft = draft
