"""What was measured and accepted in the Calibration panel so far, and the way back."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from napari_elsplus.processing.calibration.draft import Draft

if TYPE_CHECKING:
    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.processing.calibration.draft import Setup, Step, StepResult
    from napari_elsplus.viewing.calibration_script import MeasurementSource
    from napari_elsplus.widgets.calibration.picture import Picture


class ShownResult(NamedTuple):
    """What a step found, what it was measured with, how it is shown, and where its frames came from."""

    found: StepResult
    setup: Setup
    picture: Picture
    source: MeasurementSource


class Session:
    """A calibration in the making.

    Attributes
    ----------
    draft : Draft
        What was accepted.
    candidate : ShownResult or None
        What was found last, neither accepted nor discarded yet.
    """

    def __init__(self) -> None:
        self.draft = Draft()
        self.candidate: ShownResult | None = None
        self._accepted: dict[Step, ShownResult] = {}
        self._past: list[tuple[Draft, dict[Step, ShownResult]]] = []

    @property
    def past(self) -> bool:
        """Whether there is something to undo."""
        return bool(self._past)

    @property
    def sources(self) -> list[MeasurementSource]:
        """Where the frames of what was accepted came from, in the order in which it was."""
        return [shown.source for shown in self._accepted.values()]

    def shown(self, step: Step) -> ShownResult | None:
        """Return what is known of a step: the candidate, or what was accepted here."""
        return self.candidate or self._accepted.get(step)

    def accept(self, step: Step) -> bool:
        """Take the candidate into the draft; whether there was one."""
        candidate = self.candidate
        if candidate is None:
            return False
        draft = self.draft.take(candidate.found, candidate.setup)
        self._past.append((self.draft, dict(self._accepted)))
        self._accepted.pop(step, None)  # the order in which steps were accepted is the script's
        self._accepted[step] = candidate
        self.draft, self.candidate = draft, None
        return True

    def undo(self) -> bool:
        """Go back to before the last change of the draft; whether there was one."""
        if not self._past:
            return False
        self.candidate = None
        self.draft, self._accepted = self._past.pop()
        return True

    def begin_with(self, calibration: Calibration) -> None:
        """Go on from a calibration that was not made here."""
        self._past.append((self.draft, dict(self._accepted)))
        self.candidate, self._accepted = None, {}
        self.draft = Draft(calibration, bundle_um=self.draft.bundle_um)
