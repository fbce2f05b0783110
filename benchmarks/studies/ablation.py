"""Ablation of the acceptance test and of the tracker's decisions: each rule left out, each constant halved and doubled.

Every change is made in a copy of the package, by which a process of its own tracks the same recordings
(:mod:`benchmarks.studies.acceptance`). Their seeds are used for nothing else.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

import cv2
import numpy as np

from benchmarks.harness.edits import PACKAGE, ROOT, Edit, copied_checkout
from benchmarks.studies.acceptance import Row, TruePath, grid_of, recorded, total, tracked

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from numpy.typing import NDArray

SEEDS: Final = range(720, 726)
"""Seeds of the recordings, which nothing else uses; chosen: as many as take half an hour of one core."""
_TRACKING: Final = "processing/tracking"
_DUST: Final = 0.5
"""Contrast of a pattern that does not move, over that of the images."""
_DUST_PX: Final = 2.0
"""Standard deviation of the Gaussian by which it is smoothed, pixels of the grid."""


class Kind(NamedTuple):
    """Recordings of one kind.

    Parameters
    ----------
    row : Row
        Scene, motion and frame rate.
    dusty : bool
        True if a static pattern lies over the images.
    """

    row: Row
    dusty: bool = False

    def __str__(self) -> str:
        return f"{self.row}{', dust' if self.dusty else ''}"


KINDS: Final = (
    Kind(Row(0, "hand", 240.0)),
    Kind(Row(60, "hand", 240.0)),
    Kind(Row(60, "hand", 20.0)),
    Kind(Row(180, "jerky", 240.0)),
    Kind(Row(60, "jolted", 240.0)),
    Kind(Row(0, "jolted", 240.0), dusty=True),
)


class Outcome(NamedTuple):
    """Result of tracking the recordings of one kind.

    Parameters
    ----------
    wrong : int
        Registrations that were accepted and are more than 3 camera px off.
    accepted : int
        Registrations that were accepted.
    kept_percent : float
        Right registrations of those that were possible.
    drift_percent : float
        Error from first to last frame of each segment, of the path.
    """

    wrong: int
    accepted: int
    kept_percent: float
    drift_percent: float


@dataclass(frozen=True)
class Change:
    """A rule that is left out, or a constant that is changed.

    Parameters
    ----------
    rule : str
        Rule or constant, in words.
    change : str
        What is done to it.
    edits : tuple of Edit
        How.
    compiled_anew : bool
        True if kernels contain a constant that stands in a module without kernels.
    """

    rule: str
    change: str
    edits: tuple[Edit, ...] = ()
    compiled_anew: bool = False


def value_of(module: str, name: str) -> str:
    """Return the expression of a constant in a module of the tracking package."""
    text = (ROOT / PACKAGE / _TRACKING / f"{module}.py").read_text("utf-8")
    (line,) = (line for line in text.splitlines() if line.startswith(f"{name}: Final = "))
    return line.partition(" = ")[2]


def constant(
    rule: str, module: str, name: str, *, without: str = "", factors: Sequence[float] = (0.5, 2), anew: bool = False
) -> list[Change]:
    """Return the changes of a constant: halved and doubled, and the value that leaves the rule out.

    Parameters
    ----------
    rule : str
        What the constant is, in words.
    module, name : str
        Where it stands, below the tracking package.
    without : str
        Expression that leaves the rule out.
    factors : sequence of float
        By which it is multiplied.
    anew : bool
        See :attr:`Change.compiled_anew`.
    """
    value = value_of(module, name)
    whole = value.isdigit()
    new = {f"x {factor:g}": f"round({value} * {factor})" if whole else f"({value}) * {factor}" for factor in factors}
    if without:
        new = {"left out": without, **new}
    where, old = f"{_TRACKING}/{module}", f"\n{name}: Final = {value}\n"
    return [
        Change(f"{rule} ({value})", change, (Edit(where, old, f"\n{name}: Final = {to}\n"),), anew)
        for change, to in new.items()
    ]


def left_out(rule: str, module: str, *replaced: tuple[str, str], change: str = "left out") -> list[Change]:
    """Return the change that replaces texts of a module of the tracking package."""
    return [Change(rule, change, tuple(Edit(f"{_TRACKING}/{module}", old, new) for old, new in replaced))]


def changes() -> list[Change]:
    """Return all changes; that of nothing first."""
    odds, pair = "registration/odds", "registration/pair_registration"
    prediction, near = "motion/prediction", "4.0, -4.0, 8.0, -8.0"
    return [
        Change("nothing", ""),
        *constant("odds accepted from, nats", pair, "MIN_ODDS_NATS"),
        *left_out(
            "motion prior in the odds", odds,
            (" + prior_terms(other, expected, terms)[1] - prior_terms(warp, expected, terms)[1]\n", "\n"),
        ),
        *constant("degrees of freedom", "motion/motion_prior", "DEGREES_OF_FREEDOM", without="1e6", anew=True),
        *left_out(
            "competing shifts", odds, ("        against += alike * np.exp(-min(max(less, -700.0), 700.0))\n", "")
        ),
        *(
            change
            for px in ("4.0, -4.0", "8.0, -8.0", f"{near}, 12.0, -12.0, 16.0, -16.0")
            for change in left_out(
                "distances of competing shifts, px", odds, (f"({near})", f"({px})"), change=px,
            )
        ),
        *left_out(
            "competitors fitted", odds, ("_FIT: Final = Iteration(2, 2, ", "_FIT: Final = Iteration(2, 1, "),
            change="one step",
        ),
        *left_out(
            "a competitor stands for all that the prior allows", odds,
            ("max(1.0, 1 / (terms[2] * COMPETITORS_PX[0] ** 2))", "1.0"),
        ),
        *left_out(
            "weight of a Wiener filter", odds,
            ("shared = ti * ti / ((tt + n * floor) * (ii + n * floor))", "shared = 1.0"),
        ),
        *constant("pixels per independent value", odds, "CORRELATED_PX"),
        *constant("side of the blocks, px", odds, "BLOCK_PX"),
        *left_out(
            "static variance is no evidence", odds, ("            more -= min(max(more, -static), static)\n", "")
        ),
        *constant("static variance, squared grey levels", odds, "_FLOOR_DN2", without="0.0"),
        *constant("static variance, of the brightest", odds, "_FLOOR_SHARE", without="0.0"),
        *constant("sharp without competitors, px", "registration/pyramid_descent", "SHARP_PX"),
        *constant("fall of correlation", pair, "FALL_OF_CORRELATION", without="inf"),
        *constant("memory of the correlation", "tracker", "_MEMORY", without="1.0"),
        *constant("largest standard deviation, px", pair, "MAX_SIGMA_PX", without="inf"),
        *constant("uneven motion estimated from, px", "tracker", "_UNEVEN_PX", without='float("inf")'),
        *constant("jolts count as uneven", prediction, "_JOLT", without="0.0"),
        *constant("starts wait from, nats", "tracker", "_WAITING_ODDS_NATS", without="MIN_ODDS_NATS", factors=()),
        *constant("stands without a later one from, nats", "pose_graph/refinement", "SURE_ODDS_NATS", without="0.0"),
        *constant("reach of a keyframe, diameters", "tracker", "KEY_FRAME_REACH", without="0.0"),
        *constant("frames predicted", "tracker", "PATIENCE_FRAMES", without="0"),
        *constant("largest displacement, diameters", "tracker", "MAX_DISPLACEMENT_DIAMETERS", without="10.0"),
        *constant("least spread of velocity, px", prediction, "_MIN_SPREAD", without="0.0"),
        *constant("spread over recent surprise", prediction, "_SPREAD_OF_SURPRISE"),
        *constant("memory of surprise", prediction, "_MEMORY", without="0.0"),
        *constant("first velocity, diameters", prediction, "FIRST_SPEED"),
        *constant("first surprise, px", prediction, "_FIRST_SURPRISE"),
        *constant("least share of a velocity's variance", prediction, "MIN_SHARE", without="0.0"),
        *constant("change of velocity that goes on", prediction, "_KEPT", without="0.0"),
    ]  # fmt: skip


def ablate(
    chosen: Sequence[Change], seeds: Sequence[int] = SEEDS, kinds: Sequence[Kind] = KINDS,
    report: Callable[[str], object] = str,
) -> Iterator[tuple[Change, list[Outcome]]]:  # fmt: skip
    """Make each change in turn; yield it and the outcome for each kind of recording.

    Parameters
    ----------
    chosen : sequence of Change
        From :func:`changes`.
    seeds : sequence of int
        Seeds of the recordings.
    kinds : sequence of Kind
        Kinds of recordings.
    report : callable
        Takes a line on what is being done.
    """
    with tempfile.TemporaryDirectory(prefix="ablation-") as name:
        recordings = Path(name) / "recordings"
        recordings.mkdir()
        for kind in kinds:
            for seed in seeds:
                report(f"{kind}, seed {seed}")
                recording = simulated(kind, seed)
                np.savez(recordings / f"{KINDS.index(kind)}-{seed}.npz", **recording._asdict())
        for change in chosen:
            report(f"{change.rule}: {change.change}")
            without = "*.nb?" if change.compiled_anew else ".*"
            with copied_checkout(Path(name) / "copy", str(PACKAGE), without=without) as copy:
                for edit in change.edits:
                    edit.apply(copy)
                yield change, _tracked_by(copy, recordings)


def simulated(kind: Kind, seed: int) -> TruePath:
    """Simulate a recording of a kind."""
    recording = recorded(kind.row, seed)
    if not kind.dusty:
        return recording
    noise = np.random.default_rng(seed).normal(size=recording.images.shape[1:]).astype(np.float32)
    dust: NDArray[np.float32] = cv2.GaussianBlur(noise, (0, 0), _DUST_PX)
    lit = recording.images.any(axis=0)
    dust *= lit * _DUST * recording.images[:, lit].std() / dust.std()
    return recording._replace(images=recording.images + dust)


def _tracked_by(copy: Path, recordings: Path) -> list[Outcome]:
    """Track recordings in a process of its own by the package in a copy of the checkout."""
    paths = os.pathsep.join((str(copy / PACKAGE.parent), str(ROOT)))
    command = [sys.executable, "-m", "benchmarks.studies.ablation", str(recordings)]
    found = subprocess.run(command, env=os.environ | {"PYTHONPATH": paths}, capture_output=True, text=True, check=False)
    if found.returncode:
        raise RuntimeError(f"the changed package fails:\n{found.stderr[-3000:]}")
    return [Outcome(*outcome) for outcome in json.loads(found.stdout)]


def outcomes(recordings: Path) -> list[Outcome]:
    """Track all recordings of a folder, and return the outcome for each kind."""
    found = []
    for number, kind in enumerate(KINDS):
        paths = sorted(recordings.glob(f"{number}-*.npz"))
        if not paths:
            continue
        grid = grid_of(kind.row)
        c = total(tracked(TruePath(**np.load(path)), grid) for path in paths)
        found.append(
            Outcome(
                c.wrong, c.accepted, round(100 * c.kept / max(c.countable, 1), 2),
                round(100 * c.drift_px / max(c.path_px, 1e-9), 4),
            )
        )  # fmt: skip
    return found


if __name__ == "__main__":
    sys.stdout.write(json.dumps(outcomes(Path(sys.argv[1]))))
