"""Instruments drawn at random through the whole path: calibration, scan, ELS+, axial response."""

from __future__ import annotations

import csv
from dataclasses import dataclass, field
from functools import cache
from math import floor
from typing import TYPE_CHECKING, Final

import numpy as np

from benchmarks.harness.table import write_rows
from benchmarks.imperfect import measures
from benchmarks.imperfect.measures import Error
from benchmarks.imperfect.rig import ImperfectRig
from napari_elsplus.errors import ElsPlusError, InputError
from napari_elsplus.processing.axial.axial_notes import uncertainty_note
from napari_elsplus.processing.calibration.steps import find_step

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence
    from pathlib import Path

    from napari_elsplus.processing.axial.axial_response import AxialResponse

PRESET: Final = "240hz"
TOLERANCE: Final = 0.03
"""Largest deviation of a drop-off from the ideal rig's, as a share of it, that is good enough."""
MAX_RATES: Final = 3
"""Lower frame rates that are tried where each is advised; chosen: the second response is known better."""
CALIBRATED: Final = ("slit offset / rows", "galvo map at the middle / rows", "gain of the right view")
DISTANCES: Final = ("ELS+ 3 dB", "ELS+ 10 dB")
NAMES: Final = (*CALIBRATED, *DISTANCES)
COLUMNS: Final = (
    "seed", *(f"{name}, {part}" for name in NAMES for part in ("error", "stated")),
    *(f"{name}, {part}" for name in DISTANCES for part in ("relative to ideal", "relative stated")),
    "warning", "refused",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Surveyed:
    """One rig drawn at random.

    Parameters
    ----------
    seed : int
        Of the rig.
    errors : dict
        By name: error of a calibrated number or of a drop-off (um, against that of the same rig without noise), and the
        stated standard deviation.
    shares : dict
        By name: drop-off over the ideal rig's, minus 1, and the stated standard deviation.
    refused : str
        What the software said, if it refused the rig.
    warning : str
        What was warned of, if anything: rows that miss the slit, and the frame rate at which they would not; drop-offs
        that are uncertain, and how many frames there should be.
    """

    seed: int
    errors: dict[str, Error] = field(default_factory=dict)
    shares: dict[str, Error] = field(default_factory=dict)
    refused: str = ""
    warning: str = ""

    @property
    def wrong(self) -> bool:
        """True if a drop-off is farther from the ideal rig's than `TOLERANCE`."""
        return any(abs(share.off) > TOLERANCE for share in self.shares.values())

    @property
    def silently_wrong(self) -> bool:
        """True if it is wrong by more than three standard deviations, and no warning was given."""
        far = any(abs(share.off) > max(TOLERANCE, 3 * share.stated) for share in self.shares.values())
        return far and not self.warning


def survey_rig(seed: int) -> Surveyed:
    """Calibrate a rig by its seed as a user would, scan with that, and measure its axial response.

    Where the galvo cannot follow at the preset's frame rate, the rig is calibrated again at the rate that is advised.
    """
    rig = ImperfectRig.drawn(PRESET, seed)
    try:
        for _ in range(MAX_RATES):
            ramp = None if rig.scanned.lag is None else rig.scanned.lag.ramp
            if ramp is None or not ramp.highest_rate_hz:
                break
            rig = ImperfectRig.drawn(PRESET, seed, floor(ramp.highest_rate_hz))  # as the scan's step advises
        draft, calibration = rig.scanned, rig.scanned.calibration
        line_rows = rig.line_rows(calibration)
        response = measures.axial_as_advised(rig, calibration, line_rows, seed=seed)
    except ElsPlusError as error:
        return Surveyed(seed, refused=str(error))
    found = (
        measures.offset_error(rig, calibration),
        measures.galvo_error(rig, draft),
        measures.gain_error(rig, calibration),
    )
    errors, shares = dict(zip(CALIBRATED, found, strict=True)), {}
    own_um = measures.own_distances_um(rig, line_rows)
    for name, own, ideal, drop in zip(DISTANCES, own_um, _ideal_um(), _distances(response), strict=True):
        errors[name] = Error(drop.off - own, drop.stated)
        shares[name] = Error(drop.off / ideal - 1, drop.stated / ideal)
    assert draft.lag is not None
    warnings = list(find_step("lag").summary(draft, draft.lag, rig.setup).warnings)
    warnings.append(uncertainty_note(response))
    return Surveyed(seed, errors, shares, warning="; ".join(filter(None, warnings)))


@cache
def _ideal_um() -> tuple[float, float]:
    rig = ImperfectRig.of(PRESET)
    return measures.own_distances_um(rig, np.arange(rig.instrument.frame_shape[0], dtype=np.float64))


def _distances(response: AxialResponse) -> tuple[Error, Error]:
    return tuple(Error(drop.um, drop.uncertainty_um) for drop in (response.els_3db, response.els_10db))  # type: ignore[return-value]


def survey(seeds: Sequence[int], path: Path, report: Callable[[str], None] = lambda _: None) -> list[Surveyed]:
    """Survey rigs by their seeds, one after the other; those that a CSV file has already are not measured again.

    Parameters
    ----------
    seeds : sequence of int
        Of the rigs.
    path : pathlib.Path
        The CSV file, a row for each rig, which is written after each.
    report : callable
        Receives what is being done.

    Raises
    ------
    InputError
        If the file exists, and was not written by this function.
    """
    known = {one.seed: one for one in read_survey(path)} if path.exists() else {}
    for number, seed in enumerate(seeds, 1):
        if seed not in known:
            report(f"rig {number} of {len(seeds)}")
            known[seed] = survey_rig(seed)
            write_survey([known[each] for each in seeds if each in known], path, force=True)
    return [known[seed] for seed in seeds]


def markdown(surveyed: list[Surveyed]) -> str:
    """Return errors, coverage and refusals as Markdown."""
    measured = [one for one in surveyed if not one.refused]
    lines = ["| quantity | RMS error | largest | within 1 sigma | within 3 sigma |", "|---|---|---|---|---|"]
    errors = {name: [one.errors[name] for one in measured] for name in NAMES}
    errors |= {f"{name} over the ideal rig's, less 1": [one.shares[name] for one in measured] for name in DISTANCES}
    for name, pairs in errors.items() if measured else ():
        off, stated = np.array(pairs).T
        inside = [f"{100 * np.mean(np.abs(off) <= sigmas * stated):.1f} %" for sigmas in (1, 3)]
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
    refused, wrong, warned, silent = (
        sum(flags)
        for flags in zip(
            *((bool(r.refused), r.wrong, r.wrong and bool(r.warning), r.silently_wrong) for r in rigs), strict=True
        )
    )
    return (
        f"{len(rigs)} rigs drawn at random (seeds {rigs[0].seed} to {rigs[-1].seed}): {refused} refused; of the others "
        f"{wrong} with an ELS+ drop-off more than {100 * TOLERANCE:g} % from the ideal rig's, of which {warned} were "
        f"warned of, and {silent} silently by more than three standard deviations."
    )


def write_survey(surveyed: list[Surveyed], path: Path, *, force: bool = False) -> None:
    """Write a CSV file with a row for each rig.

    Raises
    ------
    InputError
        If the file exists and `force` is not given.
    """
    rows = []
    for one in surveyed:
        errors = (value for name in NAMES for value in one.errors.get(name, Error(np.nan, np.nan)))
        shares = (value for name in DISTANCES for value in one.shares.get(name, Error(np.nan, np.nan)))
        rows.append((one.seed, *(f"{value:.6g}" for value in (*errors, *shares)), one.warning, one.refused))
    write_rows(path, COLUMNS, rows, force=force)


def read_survey(path: Path) -> list[Surveyed]:
    """Return the rigs of a CSV file of :func:`write_survey`.

    Raises
    ------
    InputError
        If it is another file.
    """
    with path.open(newline="", encoding="utf-8") as file:
        reader = csv.reader(file)
        if tuple(next(reader, ())) != COLUMNS:
            raise InputError(f"{path} is no table of rigs", "choose another folder")
        rows = list(reader)
    surveyed = []
    for seed, *cells, warning, refused in rows:
        values = [float(cell) for cell in cells]
        pairs = [Error(*pair) for pair in zip(values[::2], values[1::2], strict=True)]
        errors = {} if refused else dict(zip(NAMES, pairs[: len(NAMES)], strict=True))
        shares = {} if refused else dict(zip(DISTANCES, pairs[len(NAMES) :], strict=True))
        surveyed.append(Surveyed(int(seed), errors, shares, refused, warning))
    return surveyed
