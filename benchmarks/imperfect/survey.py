"""Instruments drawn at random through the whole path: calibration, scan, ELS+, axial response."""

from __future__ import annotations

import csv
from dataclasses import dataclass, field
from functools import cache
from typing import TYPE_CHECKING, Final

import numpy as np

from benchmarks.imperfect import measures
from benchmarks.imperfect.measures import Error
from benchmarks.imperfect.rig import ImperfectRig
from napari_elsplus.errors import ElsPlusError
from napari_elsplus.io import replacing

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from pathlib import Path

    from napari_elsplus.processing.analysis.axial_response import AxialResponse

PRESET: Final = "240hz"
FIRST_SEED: Final = 5000
"""Rigs with smaller seeds were looked at while the software was written."""
TOLERANCE: Final = 0.03
"""Largest deviation of a drop-off from the ideal rig's, as a share of it, that is good enough."""
CALIBRATED: Final = ("slit offset / rows", "galvo map at the middle / rows", "gain of the right view")
DISTANCES: Final = ("ELS+ 3 dB", "ELS+ 10 dB")


@dataclass(frozen=True, slots=True)
class Surveyed:
    """One rig drawn at random.

    Parameters
    ----------
    seed : int
        Of the rig.
    errors : dict
        By name: error of a calibrated number or of a drop-off (um, against the ideal rig's), and the stated standard
        deviation.
    shares : dict
        By name: drop-off over the ideal rig's, minus 1.
    refused : str
        What the software said, if it refused the rig.
    warned : bool
        The calibration said that something may be wrong.
    """

    seed: int
    errors: dict[str, Error] = field(default_factory=dict)
    shares: dict[str, float] = field(default_factory=dict)
    refused: str = ""
    warned: bool = False

    @property
    def wrong(self) -> bool:
        """True if a drop-off is farther from the ideal rig's than `TOLERANCE`."""
        return any(abs(share) > TOLERANCE for share in self.shares.values())

    @property
    def silently_wrong(self) -> bool:
        """True if it is wrong by more than three standard deviations, and no warning was given."""
        far = any(
            abs(self.shares[name]) > TOLERANCE and abs(self.errors[name].off) > 3 * self.errors[name].stated
            for name in self.shares
        )
        return far and not self.warned


def survey_rig(seed: int) -> Surveyed:
    """Calibrate a rig by its seed as a user would, scan with that, and measure its axial response."""
    rig = ImperfectRig.drawn(PRESET, seed)
    try:
        calibration = rig.scanned.calibration
        response = measures.axial(rig, calibration, line_rows=rig.line_rows(calibration), seed=seed)
    except ElsPlusError as error:
        return Surveyed(seed, refused=str(error))
    found = (
        measures.offset_error(rig, calibration),
        measures.galvo_error(rig, calibration),
        measures.gain_error(rig, calibration),
    )
    errors, shares = dict(zip(CALIBRATED, found, strict=True)), {}
    for name, ideal, drop in zip(DISTANCES, _distances(_ideal()), _distances(response), strict=True):
        errors[name] = Error(drop.off - ideal.off, float(np.hypot(drop.stated, ideal.stated)))
        shares[name] = drop.off / ideal.off - 1
    return Surveyed(seed, errors, shares, warned=False)


@cache
def _ideal() -> AxialResponse:
    rig = ImperfectRig.of(PRESET)
    return measures.axial(rig, rig.measured.calibration, seed=FIRST_SEED - 1)


def _distances(response: AxialResponse) -> tuple[Error, Error]:
    return tuple(Error(drop.um, drop.uncertainty_um) for drop in (response.els_3db, response.els_10db))  # type: ignore[return-value]


def survey(rigs: int, report: Callable[[str], None] = lambda _: None) -> list[Surveyed]:
    """Survey a number of rigs, one after the other.

    Parameters
    ----------
    rigs : int
        How many, from the seed `FIRST_SEED` on.
    report : callable
        Receives what is being done.
    """
    found = []
    for number in range(rigs):
        report(f"rig {number + 1} of {rigs}")
        found.append(survey_rig(FIRST_SEED + number))
    return found


def markdown(surveyed: list[Surveyed]) -> str:
    """Return errors, coverage and refusals as Markdown."""
    measured = [one for one in surveyed if not one.refused]
    lines = ["| quantity | RMS error | largest | within 1 sigma | within 3 sigma |", "|---|---|---|---|---|"]
    for name in (*CALIBRATED, *DISTANCES) if measured else ():
        off, stated = np.array([one.errors[name] for one in measured]).T
        inside = [f"{100 * np.mean(np.abs(off) <= sigmas * stated):.0f} %" for sigmas in (1, 3)]
        lines.append(
            f"| {name} | {np.sqrt(np.mean(off**2)):.3g} | {np.abs(off).max():.3g} | {inside[0]} | {inside[1]} |"
        )
    lines += ["", _counts(surveyed)]
    refusals: dict[str, int] = {}
    for one in surveyed:
        if one.refused:
            refusals[one.refused[:70]] = refusals.get(one.refused[:70], 0) + 1
    lines += [f"- refused {count} times: {said}" for said, count in refusals.items()]
    return "\n".join(lines)


def _counts(surveyed: Iterable[Surveyed]) -> str:
    rigs = list(surveyed)
    refused, wrong, silent = (
        sum(flags) for flags in zip(*((bool(r.refused), r.wrong, r.silently_wrong) for r in rigs), strict=True)
    )
    return (
        f"{len(rigs)} rigs drawn at random (seeds {rigs[0].seed} to {rigs[-1].seed}): {refused} refused; of the others "
        f"{wrong} with an ELS+ drop-off more than {100 * TOLERANCE:g} % from the ideal rig's, "
        f"{silent} of them silently."
    )


def write_survey(surveyed: list[Surveyed], path: Path, *, force: bool = False) -> None:
    """Write a CSV file with a row for each rig.

    Raises
    ------
    InputError
        If the file exists and `force` is not given.
    """
    names = (*CALIBRATED, *DISTANCES)
    with replacing(path, force=force) as unfinished, unfinished.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["seed", *(f"{name}, {part}" for name in names for part in ("error", "stated")), "refused"])
        for one in surveyed:
            errors = (one.errors.get(name, Error(np.nan, np.nan)) for name in names)
            writer.writerow([one.seed, *(f"{value:.6g}" for error in errors for value in error), one.refused])
