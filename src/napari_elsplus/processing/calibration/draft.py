"""A calibration in the making: step after step is accepted, and each is known to be done, stale or missing."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from napari_elsplus.errors import InputError
from napari_elsplus.instrument.calibration import AcquiredWith, Calibration, FrameSection, OpticsSection
from napari_elsplus.instrument.optics import BUNDLE_UM
from napari_elsplus.processing.calibration.calibrate import (
    Background,
    BundlePair,
    SlitOffset,
    bundle_section,
    galvo_section,
    offset_section,
    with_flat_and_quality,
)
from napari_elsplus.processing.calibration.galvo import GalvoMap
from napari_elsplus.processing.calibration.lag import ScanLag
from napari_elsplus.processing.calibration.steps import offset_at

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

MOVED_ROWS: Final = 0.5
"""By this much the slit offset may differ from the bundle images' before one of them is out of date."""


class Step(StrEnum):
    """The calibration's steps, in the order in which they are safe: the tilt mirror is turned in the first only."""

    OFFSET = "slit offset"
    GALVO = "galvo map"
    PAIR = "bundle pair"
    LAG = "scan lag"
    BACKGROUND = "background"
    FLAT = "flat field"


class StepState(StrEnum):
    """Whether a step has to be done."""

    DONE = "done"
    STALE = "stale"
    MISSING = "missing"


@dataclass(frozen=True, slots=True)
class Setup:
    """What frames were taken with.

    Parameters
    ----------
    frame : FrameSection
        Their shape, and where on the sensor they begin.
    acquired_with : AcquiredWith
        The rig's settings; empty for frames from a file.
    line_period_s, line_periods_per_frame : float, optional
        Timing.
    um_per_px : float, optional
        Scale that the objective should have; the bundle's image tells better.
    """

    frame: FrameSection
    acquired_with: AcquiredWith = field(default_factory=AcquiredWith)
    line_period_s: float | None = None
    line_periods_per_frame: float | None = None
    um_per_px: float | None = None


@dataclass(frozen=True, slots=True)
class LitPair:
    """Both bundle images, and the mean frame (rows, cols) in which they were found."""

    pair: BundlePair
    image: NDArray[np.float32]

    @property
    def offset_rows(self) -> float:
        """Row of the right bundle image minus that of the left: the slit offset, independent of the laser line."""
        return self.pair.right.centre[0] - self.pair.left.centre[0]

    @property
    def offset_uncertainty_rows(self) -> float:
        """One standard deviation of :attr:`offset_rows`."""
        return float(np.hypot(self.pair.right.centre_uncertainty_px, self.pair.left.centre_uncertainty_px))


@dataclass(frozen=True, slots=True)
class Flat:
    """A flat field, (n, n), mean 1 inside the disc."""

    image: NDArray[np.float32]


StepResult = SlitOffset | GalvoMap | LitPair | ScanLag | Background | Flat
_STEPS: Final[dict[type, Step]] = {
    SlitOffset: Step.OFFSET,
    GalvoMap: Step.GALVO,
    LitPair: Step.PAIR,
    ScanLag: Step.LAG,
    Background: Step.BACKGROUND,
    Flat: Step.FLAT,
}
_SECTIONS: Final = {
    "offset": Step.OFFSET,
    "galvo": Step.GALVO,
    "bundle": Step.PAIR,
    "background": Step.BACKGROUND,
}


def step_of(found: StepResult) -> Step:
    """Return the step that finds such a thing."""
    return _STEPS[type(found)]


@dataclass(frozen=True)
class Draft:
    """A calibration in the making. Immutable: accepting a step returns the next draft, so undoing is keeping the last.

    Parameters
    ----------
    calibration : Calibration
        What is known so far; complete or not.
    found : mapping
        What each step found, as far as it was measured here and not read from a file.
    outdated : mapping
        Steps that do not hold any more, and why.
    bundle_um : float
        Diameter of the imaged part of the bundle, which gives the scale.

    Examples
    --------
    >>> draft = Draft(Calibration.parse({"offset": {"rows": -12.03, "uncertainty_rows": 0.01}}))
    >>> [str(draft.state(step)[0]) for step in (Step.OFFSET, Step.GALVO)]
    ['done', 'missing']
    """

    calibration: Calibration = field(default_factory=Calibration)
    found: Mapping[Step, StepResult] = field(default_factory=dict)
    outdated: Mapping[Step, str] = field(default_factory=dict)
    bundle_um: float = BUNDLE_UM

    @property
    def pair(self) -> BundlePair | None:
        """The bundle pair, if it was measured here."""
        lit = self.found.get(Step.PAIR)
        return lit.pair if isinstance(lit, LitPair) else None

    @property
    def um_per_px(self) -> float | None:
        """The scale, if it is known."""
        return self.calibration.um_per_px

    def state(self, step: Step, setup: Setup | None = None) -> tuple[StepState, str]:
        """Say whether a step has to be done, and why; given a rig's setup, whether it still holds there."""
        if not self._has(step):
            return StepState.MISSING, self.needs(step)
        if step in self.outdated:
            return StepState.STALE, self.outdated[step]
        reason = "" if setup is None else _stale(self.calibration, setup).get(step, "")
        return (StepState.STALE, reason) if reason else (StepState.DONE, "")

    def needs(self, step: Step) -> str:
        """Say which steps have to come first; empty if none."""
        before: dict[Step, tuple[Step, ...]] = {
            Step.LAG: (Step.GALVO, Step.PAIR),
            Step.BACKGROUND: (Step.GALVO, Step.PAIR),
            Step.FLAT: (Step.GALVO, Step.PAIR),
        }
        missing = [other for other in before.get(step, ()) if not self._has(other)]
        return f"first the {' and the '.join(missing)}" if missing else ""

    def take(self, found: StepResult, setup: Setup) -> Draft:
        """Accept what a step found.

        Parameters
        ----------
        found : SlitOffset, GalvoMap, LitPair, ScanLag, Background or Flat
            What was measured.
        setup : Setup
            What it was measured with.

        Returns
        -------
        Draft
            With the step done; steps that this puts out of date are known as such.

        Raises
        ------
        InputError
            If a scan's lag is found before the galvo map.
        MeasurementError
            If the two views do not fit each other.
        """
        step = step_of(found)
        outdated = {**self.outdated, **_stale(self.calibration, setup)}
        draft = replace(self, found={**self.found, step: found}, calibration=self._set_up(setup))
        match found:
            case SlitOffset():
                calibration, late = _with_offset(draft), self._moved(found)
            case GalvoMap():
                late = {Step.LAG: "the galvo map is newer"} if self._has(Step.LAG) else {}
                calibration = _with_galvo(draft)
            case LitPair():
                calibration, late = _with_pair(draft, found), {}
            case ScanLag():
                calibration, late = _with_lag(draft.calibration, found), {}
            case Background():
                calibration, late = draft.calibration.model_copy(update={"background": found.mean}), {}
            case Flat():
                calibration, late = draft.calibration.model_copy(update={"flat": found.image}), {}
        outdated = {other: why for other, why in (outdated | late).items() if other is not step}
        return replace(draft, calibration=calibration, outdated=outdated)

    def _has(self, step: Step) -> bool:
        known = self.calibration
        match step:
            case Step.OFFSET:
                return known.offset is not None
            case Step.GALVO:
                return known.galvo is not None
            case Step.PAIR:
                return known.bundle is not None
            case Step.LAG:
                return known.galvo is not None and (known.galvo.lag_s != 0 or Step.LAG in self.found)
            case Step.BACKGROUND:
                return known.background is not None
            case Step.FLAT:
                return known.flat is not None

    def _set_up(self, setup: Setup) -> Calibration:
        """Note what the frames were taken with; arrays of another shape cannot be kept."""
        known = self.calibration
        update: dict[str, Any] = {"frame": setup.frame}
        if setup.acquired_with != AcquiredWith():
            update["acquired_with"] = setup.acquired_with
        timing = {"line_period_s": setup.line_period_s, "line_periods_per_frame": setup.line_periods_per_frame}
        given = {name: value for name, value in timing.items() if value is not None}
        if given:
            update["optics"] = (known.optics or OpticsSection()).model_copy(update=given)
        if known.frame is not None and known.frame.shape != setup.frame.shape:
            update |= {"background": None, "flat": None, "quality": None}
        return known.model_copy(update=update)

    def _moved(self, offset: SlitOffset) -> dict[Step, str]:
        """Say what is out of date because the tilt mirror was turned."""
        bundle = self.calibration.bundle
        if bundle is None:
            return {}
        moved = offset.rows - (bundle.residual_centre[0] - bundle.confocal_centre[0])
        if abs(moved) <= MOVED_ROWS:
            return {}
        return dict.fromkeys((Step.PAIR, Step.BACKGROUND), f"the offset has moved by {moved:.1f} rows since")


def _with_offset(draft: Draft) -> Calibration:
    offset, pair = draft.found.get(Step.OFFSET), draft.pair
    if not isinstance(offset, SlitOffset):
        return draft.calibration
    seen = offset if pair is None else offset_at(offset, pair)
    return draft.calibration.model_copy(update={"offset": offset_section(seen)})


def _with_galvo(draft: Draft) -> Calibration:
    galvo, pair, known = draft.found.get(Step.GALVO), draft.pair, draft.calibration
    if not isinstance(galvo, GalvoMap):
        return known
    if pair is not None:
        galvo = galvo.at_column(pair.left.centre[1])
    section = galvo_section(galvo, pair, draft.um_per_px)
    if known.galvo is not None:
        update: dict[str, Any] = {"lag_s": known.galvo.lag_s}
        section = section.model_copy(update=update if pair is not None else update | {"park_v": known.galvo.park_v})
    return known.model_copy(update={"galvo": section})


def _with_pair(draft: Draft, lit: LitPair) -> Calibration:
    known = draft.calibration
    scale = draft.bundle_um / lit.pair.left.diameter_px
    optics = (known.optics or OpticsSection()).model_copy(update={"um_per_px": scale})
    known = known.model_copy(update={"bundle": bundle_section(lit.pair), "optics": optics})
    known = with_flat_and_quality(known, lit.pair, lit.image[None], None)
    known = _with_offset(replace(draft, calibration=known))
    return _with_galvo(replace(draft, calibration=known))


def _with_lag(known: Calibration, lag: ScanLag) -> Calibration:
    if known.galvo is None:
        raise InputError("a scan's lag belongs to a galvo map", "measure the galvo map first")
    late = {"lag_s": lag.lag_s, "lag_uncertainty_s": lag.uncertainty_s}
    return known.model_copy(update={"galvo": known.galvo.model_copy(update=late)})


def _stale(calibration: Calibration, setup: Setup) -> dict[Step, str]:
    sections = calibration.stale_sections(setup.acquired_with, setup.frame)
    return {_SECTIONS[name]: reason for name, reason in sections.items() if name in _SECTIONS}
