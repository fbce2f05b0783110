"""The description of a calibration step, which panel, command line, engine and documentation read."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Any, Final, Generic, TypeVar

from napari_elsplus.errors import InputError
from napari_elsplus.instrument.calibration import Calibration, utc_now
from napari_elsplus.instrument.staleness import changed_setting, stale_sections

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    import numpy as np
    from numpy.typing import NDArray

    from napari_elsplus.processing.calibration.draft import Draft, Setup
    from napari_elsplus.processing.calibration.scan.learned_ramp import Scans
    from napari_elsplus.processing.images.sectioning import Frames
    from napari_elsplus.processing.progress import ProgressWrapper

T = TypeVar("T")


class Target(StrEnum):
    """Scene that must lie before the probe during a step."""

    FAR_END_LIT = "light the bundle from its far end"
    FLUORESCENT = "put the probe onto an evenly fluorescent target"
    DARK_TUBE = "put the probe into the dark tube"


class Capture(StrEnum):
    """Motion of the line while a step's frames are taken."""

    HELD = "line held on the middle of the bundle"
    SWEEP = "line held at one voltage after another"
    PARKED = "line parked beside the bundle"
    SCANNING = "line scanning"
    LEADS = "line scanning with one lead after another"

    @property
    def needs(self) -> tuple[str, ...]:
        """Keys of the steps without which the line cannot be moved so."""
        return ("galvo", "pair") if self in {Capture.SCANNING, Capture.LEADS} else ()


class StepState(StrEnum):
    """State of a step in a draft."""

    DONE = "done"
    STALE = "stale"
    MISSING = "missing"


@dataclass(frozen=True, slots=True)
class StepInputs:
    """Frames from which a step is estimated.

    Parameters
    ----------
    frames : sequence of numpy.ndarray
        Raw frames (rows, cols); empty for ``Capture.LEADS``.
    setup : Setup
        Settings with which they were taken.
    volts : numpy.ndarray, optional
        A voltage per frame, for ``Capture.SWEEP``.
    scans : Scans, optional
        Takes frames of scans by trial calibrations, for ``Capture.LEADS``.
    progress : callable
        Wraps the numbers of the parts of a long estimate.
    """

    frames: Frames
    setup: Setup
    volts: NDArray[np.floating] | None = None
    scans: Scans | None = None
    progress: ProgressWrapper = iter


@dataclass(frozen=True)
class StepSummary:
    """A step's result in words.

    Parameters
    ----------
    headline : str
        The number that matters, with its uncertainty; at most two lines.
    lines : sequence of str
        The numbers behind it.
    warnings : sequence of str
        What is not as it should be.
    details : sequence of str
        Evidence behind the numbers, for reports and tooltips.
    """

    headline: str
    lines: Sequence[str] = ()
    warnings: Sequence[str] = ()
    details: Sequence[str] = ()


def _none_outdated(_draft: Draft, _found: Any) -> Mapping[str, str]:
    return {}


@dataclass(frozen=True, slots=True)
class CalibrationStep(Generic[T]):
    """A calibration step: what it needs, the frames it takes, its estimate, and its place in the calibration.

    Its functions must be importable by name, so that the step can be sent to the engine's process.

    Parameters
    ----------
    key : str
        Identifies the step.
    title : str
        Its name for the user.
    explanation, preparation : str
        What it measures, and what the user does for it at the microscope; a sentence each.
    target : Target
        What must lie before the probe.
    capture : Capture
        How the line moves while frames are taken.
    estimate : callable
        From the inputs and the draft so far to the result, with its uncertainty.
    apply : callable
        From a draft that contains the result, and the result, to the calibration with it.
    summarize : callable
        From the result, a draft that contains it, and its setup to a summary.
    section : str
        Attribute of the calibration, or key of its JSON file, that holds the result.
    frames : int
        How many are averaged; of a sweep and of leads, as many as they need.
    needs : tuple of str
        Keys of the steps whose results the estimate needs; those that moving the line needs are added when live.
    option, option_help : str
        Name and help of the option of ``calibrate`` that takes recorded frames; none by default.
    settings : tuple of str
        Settings of `AcquiredWith` by whose change the result becomes stale, beyond those of
        :func:`~napari_elsplus.instrument.staleness.stale_sections`.
    optional : bool
        Left out when a rig is calibrated as a whole.
    outdates : callable
        From the draft before and the result to the reasons why other steps no longer hold, by key.
    measured : callable, optional
        Returns True if a draft contains the result; by default if its calibration contains the section.
    """

    key: str
    title: str
    explanation: str
    preparation: str
    target: Target
    capture: Capture
    estimate: Callable[[StepInputs, Draft], T]
    apply: Callable[[Draft, T], Calibration]
    summarize: Callable[[T, Draft, Setup], StepSummary]
    section: str
    frames: int = 1
    needs: tuple[str, ...] = ()
    option: str = ""
    option_help: str = ""
    settings: tuple[str, ...] = ()
    optional: bool = False
    outdates: Callable[[Draft, T], Mapping[str, str]] = field(default=_none_outdated)
    measured: Callable[[Draft], bool] | None = None

    def is_measured(self, draft: Draft) -> bool:
        """Return True if a draft contains the step's result."""
        if self.measured is not None:
            return self.measured(draft)
        return getattr(draft.calibration, self.section, None) is not None

    def missing(self, draft: Draft, *, live: bool = True) -> str:
        """Name the steps that must come first.

        Parameters
        ----------
        draft : Draft
            Results so far.
        live : bool
            Measured on a rig, where the line has to be moved, and not from a file.

        Returns
        -------
        str
            Empty if none is missing.
        """
        keys = (*self.capture.needs, *self.needs) if live else self.needs
        steps = [REGISTERED[key] for key in dict.fromkeys(keys)]
        missing = [step.title for step in steps if not step.is_measured(draft)]
        return f"first the {' and the '.join(missing)}" if missing else ""

    def state(self, draft: Draft, setup: Setup | None = None) -> tuple[StepState, str]:
        """Return the step's state in a draft, and the reason.

        Parameters
        ----------
        draft : Draft
            Results so far.
        setup : Setup, optional
            Settings of a rig, to which the result is compared.
        """
        if not self.is_measured(draft):
            return StepState.MISSING, self.missing(draft)
        reason = draft.outdated.get(self.key, "")
        if not reason and setup is not None:
            reason = _stale_steps(draft.calibration, setup).get(self.key, "")
        return (StepState.STALE, reason) if reason else (StepState.DONE, "")

    def accept(self, draft: Draft, found: T, setup: Setup) -> Draft:
        """Return the draft with a result of this step.

        Parameters
        ----------
        draft : Draft
            Results so far.
        found : object
            Result of :attr:`estimate`.
        setup : Setup
            Settings with which its frames were taken.

        Raises
        ------
        InputError
            If the result belongs to a step that is missing.
        MeasurementError
            If the two views do not fit each other.
        """
        outdated = {**draft.outdated, **_stale_steps(draft.calibration, setup), **self.outdates(draft, found)}
        outdated.pop(self.key, None)
        measured = draft.with_setup(setup)
        measured = measured.with_calibration(measured.calibration.model_copy(update={"created": utc_now()}))
        after = replace(measured, found={**draft.found, self.key: found}, outdated=outdated)
        return replace(after, calibration=self.apply(after, found))

    def summary(self, draft: Draft, found: T, setup: Setup) -> StepSummary:
        """Summarize a result that was accepted into a draft, or may be; parameters as of :meth:`accept`."""
        accepted = draft if draft.found.get(self.key) is found else self.accept(draft, found, setup)
        return self.summarize(found, accepted, setup)


REGISTERED: Final[dict[str, CalibrationStep[Any]]] = {}
"""Steps by key, in their order; read with :func:`napari_elsplus.processing.calibration.steps.calibration_steps`."""


def register_step(step: CalibrationStep[T]) -> CalibrationStep[T]:
    """Append a step to the registry, or replace the one with its key; return it.

    Raises
    ------
    InputError
        If it needs a step that is not registered.
    """
    unknown = [key for key in step.needs if key not in REGISTERED]
    if unknown:
        raise InputError(f"the step {step.key} needs {unknown[0]}, which is no step", "register that step first")
    REGISTERED[step.key] = step
    return step


def _stale_steps(calibration: Calibration, setup: Setup) -> dict[str, str]:
    """Reasons why steps do not hold with a setup, by key."""
    sections = stale_sections(calibration, setup.acquired_with, setup.frame)
    stale = {}
    for step in REGISTERED.values():
        for name in step.settings:
            if change := changed_setting(name, calibration.acquired_with, setup.acquired_with):
                stale[step.key] = change
        if step.section in sections:
            stale[step.key] = sections[step.section]
    return stale
