"""Every imperfection that was tried on the software: what is measured under it, and what should hold."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cache
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from benchmarks.imperfect import measures
from benchmarks.imperfect.rig import ImperfectRig
from napari_elsplus.simulation.model.axial_response import LINE_MODELS
from napari_elsplus.simulation.model.imperfections import IDEAL, Imperfections
from napari_elsplus.simulation.specimen.scenes import nuclei

if TYPE_CHECKING:
    from collections.abc import Callable

    from napari_elsplus.instrument.calibration import Calibration

SEEDS: Final = (31, 32)
"""Seeds of the scenes, over which a number is averaged; none of them was used to settle a threshold."""
TRACKED_FRAMES: Final = 120
ROWS: Final = "rows"
"""The corrections of rows when images are made: the camera's noise, and the laser's power."""


class Aim(NamedTuple):
    """What should hold of a disturbed number, in words and as a test of the clean and the disturbed one."""

    text: str
    holds: Callable[[float, float], bool]


def at_least(limit: float) -> Aim:
    """Return the aim of a number at or above a limit."""
    return Aim(f">= {limit:g}", lambda _, disturbed: disturbed >= limit)


def at_most(limit: float) -> Aim:
    """Return the aim of a number at or below a limit."""
    return Aim(f"<= {limit:g}", lambda _, disturbed: disturbed <= limit)


def of_clean(factor: float) -> Aim:
    """Return the aim of a number within a factor of the clean one: above it if the factor is below 1, else below it."""
    if factor < 1:
        return Aim(f">= {factor:g} x clean", lambda clean, disturbed: disturbed >= factor * clean)
    return Aim(f"<= {factor:g} x clean", lambda clean, disturbed: disturbed <= factor * clean)


def near_clean(share: float) -> Aim:
    """Return the aim of a number within a share of the clean one."""
    return Aim(f"within {100 * share:g} % of clean", lambda clean, other: abs(other / clean - 1) <= share)


class Quantity(NamedTuple):
    """A number measured on a rig: name, unit, digits to display, function of rig and corrections off, the line."""

    name: str
    unit: str
    digits: int
    measure: Callable[[ImperfectRig, tuple[str, ...]], float]
    line: str = "a"


@dataclass(frozen=True)
class Case:
    """One imperfection, and one number that is measured under it.

    Parameters
    ----------
    name : str
        What is disturbed, in words.
    imperfections : str
        As on the command line.
    quantity : Quantity
        What is measured.
    aim : Aim
        What should hold.
    preset : str
        Preset of the camera; ``"240hz at 230 Hz"`` at a lower frame rate.
    corrections : tuple of str
        Parts of the calibration that correct it; the number without them is measured, too.
    quick : bool
        Part of the quick form.
    """

    name: str
    imperfections: str
    quantity: Quantity
    aim: Aim
    preset: str = "120hz"
    corrections: tuple[str, ...] = ()
    quick: bool = field(default=False, kw_only=True)

    @property
    def disturbed(self) -> ImperfectRig:
        """The imperfect rig."""
        return _rig(self.preset, self.imperfections, self.quantity.line)

    @property
    def calibration(self) -> Calibration:
        """The calibration of the imperfect rig, with the full-speed scan if the quantity is the scan's."""
        rig = self.disturbed
        return (rig.scanned if self.quantity in (ROWS_OFF, SCAN_SIGNAL, NUCLEI_SCANNED) else rig.measured).calibration

    @property
    def clean(self) -> ImperfectRig:
        """The same rig without the imperfection."""
        return _rig(self.preset, "", self.quantity.line)


@cache
def _rig(preset: str, imperfections: str, line: str) -> ImperfectRig:
    name, _, rate = preset.partition(" at ")
    rate_hz = float(rate.removesuffix(" Hz")) if rate else None
    return ImperfectRig.of(name, Imperfections.parse(imperfections), rate_hz=rate_hz, line=LINE_MODELS[line])


def corrected(rig: ImperfectRig, off: tuple[str, ...]) -> Calibration:
    """Return the measured calibration of a rig without some of its corrections."""
    return without(rig.measured.calibration, off)


def without(calibration: Calibration, off: tuple[str, ...]) -> Calibration:
    """Return a calibration without some of its corrections, by the names of its fields."""
    reset = dict.fromkeys((*off, "needs")) | {"version": 1}  # which needs no array
    changes: dict[str, Any] = {name: value for name, value in reset.items() if name in type(calibration).model_fields}
    if "scan_correction" in off and calibration.galvo is not None:  # without the fitted response, too
        changes["galvo"] = calibration.galvo.model_copy(update={"natural_hz": None, "damping": None})
    return calibration.model_copy(update=changes) if off else calibration


def corrects(calibration: Calibration, corrections: tuple[str, ...]) -> bool:
    """Return True if a calibration contains one of the corrections; that of the rows is made without it."""
    return ROWS in corrections or any(getattr(calibration, name, None) is not None for name in corrections)


def _haze(rig: ImperfectRig, off: tuple[str, ...]) -> float:
    calibration, referenced = corrected(rig, off), ROWS not in off
    scenes = [(measures.hazy_nuclei(seed), seed) for seed in SEEDS]
    found = [
        measures.sectioning(rig, calibration, scene, seed=seed, row_corrections=referenced) for scene, seed in scenes
    ]
    return float(np.mean([one.els for one in found]))


def _nuclei(rig: ImperfectRig, off: tuple[str, ...]) -> float:
    calibration = corrected(rig, off)
    return float(np.mean([measures.sectioning(rig, calibration, nuclei(seed), seed=seed).els for seed in SEEDS]))


def _haze_flat_fielded(rig: ImperfectRig, off: tuple[str, ...]) -> float:
    calibration, line_rows = corrected(rig, off), np.arange(rig.instrument.frame_shape[0], dtype=np.float64)
    straight = ImperfectRig(replace(rig.instrument, imperfections=IDEAL))
    scenes = [(measures.hazy_nuclei(seed), seed) for seed in SEEDS]
    found = [measures.flat_fielded(rig, straight, calibration, scene, line_rows, seed=seed) for scene, seed in scenes]
    return float(np.mean(found))


def _nuclei_scanned(rig: ImperfectRig, off: tuple[str, ...]) -> float:
    calibration = without(rig.scanned.calibration, off)
    line_rows = rig.line_rows(calibration)
    straight = ImperfectRig(replace(rig.instrument, imperfections=IDEAL))
    found = [measures.flat_fielded(rig, straight, calibration, nuclei(seed), line_rows, seed=seed) for seed in SEEDS]
    return float(np.mean(found))


def _alignment(rig: ImperfectRig, off: tuple[str, ...]) -> float:
    return measures.misalignment(rig, corrected(rig, off)).left_over_px


def _alignment_stated(rig: ImperfectRig, off: tuple[str, ...]) -> float:
    found = measures.misalignment(rig, corrected(rig, off))
    return found.left_over_px / found.stated_px


def _offset(rig: ImperfectRig, off: tuple[str, ...]) -> float:
    return abs(measures.offset_error(rig, corrected(rig, off)).off)


def _offset_stated(rig: ImperfectRig, off: tuple[str, ...]) -> float:
    found = measures.offset_error(rig, corrected(rig, off))
    return abs(found.off) / found.stated


def _galvo(rig: ImperfectRig, _: tuple[str, ...]) -> float:
    return abs(measures.galvo_error(rig, rig.measured).off)


def _bow(rig: ImperfectRig, off: tuple[str, ...]) -> float:
    return abs(measures.bow_error(rig, corrected(rig, off)).off)


def _tracked(rig: ImperfectRig, off: tuple[str, ...]) -> float:
    return measures.tracked(rig, corrected(rig, off), TRACKED_FRAMES, seed=SEEDS[0]).share


def _tracking_error(rig: ImperfectRig, off: tuple[str, ...]) -> float:
    return measures.tracked(rig, corrected(rig, off), TRACKED_FRAMES, seed=SEEDS[0]).rms_px


def _els_10db(rig: ImperfectRig, off: tuple[str, ...]) -> float:
    return measures.axial(rig, corrected(rig, off), seed=SEEDS[0]).els_10db.um


def _ls_10db(rig: ImperfectRig, off: tuple[str, ...]) -> float:
    return measures.axial(rig, corrected(rig, off), seed=SEEDS[0]).ls_10db.um


def _scanned(rig: ImperfectRig, off: tuple[str, ...]) -> measures.Scanned:
    return measures.scanned(rig, rig.line_rows(without(rig.scanned.calibration, off)))


HAZE: Final = Quantity("haze: ELS+ correlation", "", 3, _haze)
HAZE_FLAT_FIELDED: Final = Quantity("haze, flat-fielded: ELS+ correlation", "", 3, _haze_flat_fielded)
NUCLEI: Final = Quantity("nuclei, line b: ELS+ correlation", "", 4, _nuclei, "b")
NUCLEI_SCANNED: Final = Quantity(
    "nuclei, line b, scanned and flat-fielded: ELS+ correlation", "", 4, _nuclei_scanned, "b"
)
ALIGNMENT: Final = Quantity("view alignment, left over", "px", 3, _alignment)
ALIGNMENT_STATED: Final = Quantity("view alignment, left over / stated", "", 2, _alignment_stated)
OFFSET: Final = Quantity("slit offset, error", "rows", 4, _offset)
OFFSET_STATED: Final = Quantity("slit offset, error / stated", "", 2, _offset_stated)
GALVO: Final = Quantity("galvo map, error at the middle", "rows", 3, _galvo)
BOW: Final = Quantity("bow of the line, error at the rim", "rows", 3, _bow)
TRACKED: Final = Quantity("frames tracked in the first segment", "", 3, _tracked)
TRACKING: Final = Quantity("tracking error", "px", 3, _tracking_error)
ELS_10DB: Final = Quantity("ELS+ 10 dB distance", "um", 1, _els_10db)
LS_10DB: Final = Quantity("LS 10 dB distance", "um", 1, _ls_10db)
ROWS_OFF: Final = Quantity(
    "rows off by more than a quarter slit", "", 0, lambda rig, off: float(_scanned(rig, off).off)
)
SCAN_SIGNAL: Final = Quantity("signal kept by the scan", "", 3, lambda rig, off: _scanned(rig, off).signal)

_LEARNED: Final = ("scan_correction",)
_GAINS: Final = ("gain_map", "residual_flat")


def _mirror(name: str, imperfections: str, preset: str = "240hz", *, quick: bool = False) -> tuple[Case, ...]:
    return (
        Case(name, imperfections, ROWS_OFF, at_most(0), preset, _LEARNED, quick=quick),
        Case(name, imperfections, SCAN_SIGNAL, at_least(0.99), preset, _LEARNED),
    )


def _distortion(name: str, imperfections: str, *, quick: bool = False) -> tuple[Case, ...]:
    return (
        Case(name, imperfections, ALIGNMENT, at_most(0.13), "120hz", ("distortion",), quick=quick),
        Case(name, imperfections, ALIGNMENT_STATED, at_most(3), "120hz", ("distortion",)),
        Case(name, imperfections, HAZE, of_clean(0.97), "120hz", ("distortion",)),
    )


def _offset_cases(name: str, imperfections: str, preset: str, *, quick: bool = False) -> tuple[Case, ...]:
    return (
        Case(name, imperfections, OFFSET, at_most(0.02), preset, quick=quick),
        Case(name, imperfections, OFFSET_STATED, at_most(3), preset),
    )


CASES: Final = (
    *_mirror("galvo of 800 Hz, not stated", "galvo-resonance=800"),
    *_mirror("galvo of 500 Hz, damping 0.3", "galvo-resonance=500,galvo-damping=0.3", "240hz at 230 Hz"),
    *_mirror("galvo of 600 Hz, damping 1", "galvo-resonance=600,galvo-damping=1", "240hz at 230 Hz"),
    *_mirror("galvo of 2000 Hz, damping 1, late by 100 us", "galvo-resonance=2000,galvo-damping=1,galvo-delay=100"),
    *_mirror("galvo damped by 0.4", "galvo-damping=0.4"),
    *_mirror("galvo with an s-curve of 2 rows", "galvo-s-curve=2"),
    *_mirror("galvo of 800 Hz, 120 Hz preset", "galvo-resonance=800", "120hz"),
    *_distortion("right view distorted by -0.3 %", "right-distortion=-0.3"),
    *_distortion("right view distorted by -0.8 %", "right-distortion=-0.8"),
    *_distortion("right view distorted by 1 %", "right-distortion=1", quick=True),
    *_distortion("left view distorted by 1 %", "left-distortion=1"),
    *_distortion("lens distorted by 0.2 %", "lens-distortion=0.2"),
    *_distortion("lens distorted by 0.5 %", "lens-distortion=0.5"),
    *_distortion("lens distorted by 1 %", "lens-distortion=1"),
    Case("right view's cores differ by 10 %", "right-core-gain=10", HAZE, at_least(0.70), "120hz", _GAINS, quick=True),
    Case("right view's vignette of 10 %", "right-vignette=10", HAZE, at_least(0.70), "120hz", _GAINS),
    Case("right view's vignette of -10 %", "right-vignette=-10", HAZE, at_least(0.70), "120hz", _GAINS),
    Case("right view brighter for the lamp by 5 %", "lamp-gain=5", ELS_10DB, near_clean(0.03)),
    Case("right view dimmer for the lamp by 5 %", "lamp-gain=-5", ELS_10DB, near_clean(0.03)),
    *_offset_cases("row noise of 0.5 grey levels", "row-noise=0.5", "240hz"),
    *_offset_cases("row noise of 2 grey levels", "row-noise=2", "240hz", quick=True),
    *_offset_cases("row noise of 2 grey levels, 120 Hz", "row-noise=2", "120hz"),
    Case("row noise of 2 grey levels", "row-noise=2", HAZE, of_clean(0.95), corrections=(ROWS,)),
    Case("laser power noise of 5 % from row to row", "power-noise=5", HAZE, at_least(0.66), corrections=(ROWS,)),
    Case("laser power ripple of 5 % at 2.3 kHz", "power-ripple=5", HAZE, at_least(0.66), corrections=(ROWS,)),
    Case("laser power ripple of 5 % at 100 Hz", "power-ripple=5,ripple-frequency=100", HAZE, of_clean(0.98)),
    *_offset_cases("laser power noise of 5 % from row to row", "power-noise=5", "240hz"),
    *_offset_cases("laser power ripple of 5 % at 2.3 kHz", "power-ripple=5", "240hz"),
    Case("laser power noise of 5 % from row to row", "power-noise=5", TRACKING, of_clean(2.0), "240hz"),
    Case("line bowed by 3 rows", "line-bow=3", GALVO, at_most(0.1)),
    Case("line bowed by 3 rows", "line-bow=3", BOW, at_most(0.1)),
    Case("line bowed by 3 rows", "line-bow=3", NUCLEI_SCANNED, at_least(0.990)),
    Case("line jitters by 3 rows", "line-jitter=3", TRACKED, at_least(0.98), "240hz"),
    Case("line dimmer by 30 % at its ends, slanted by 10 %", "line-fall-off=30,line-slant=10", HAZE, of_clean(0.97)),
    Case("line dimmer by 30 % at its ends, slanted by 10 %", "line-fall-off=30,line-slant=10", HAZE_FLAT_FIELDED,
         of_clean(0.97)),
    Case("specimen bleached by 20 % in the scan", "bleaching=28", ELS_10DB, near_clean(0.03)),
    Case("specimen bleached by 20 % in the scan", "bleaching=28", LS_10DB, near_clean(0.03)),
    Case("half of the halo in collection", "halo-in-collection=50", NUCLEI, of_clean(0.98)),
    Case("hot pixels, 0.1 %", "hot-pixels=0.1", HAZE, of_clean(0.97)),
    Case("pixels differ by 1.5 % in gain", "prnu=1.5", HAZE, of_clean(0.97)),
    Case("ghost of 2 %", "ghost=2", HAZE, of_clean(0.97)),
    *_offset_cases("ghost of 2 %", "ghost=2", "240hz"),
    Case("bundle bent while it moves, 5 %", "bundle-bending=5", TRACKED, at_least(0.98), "240hz"),
)  # fmt: skip
