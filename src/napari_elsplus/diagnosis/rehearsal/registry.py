"""Registry of rehearsed faults, each a function of a stage."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from napari_elsplus.diagnosis.rehearsal.row import Row
from napari_elsplus.diagnosis.rehearsal.stage import Stage
from napari_elsplus.errors import ElsPlusError, InputError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

FAULTS: Final[dict[str, Fault]] = {}
"""Every fault by its name, in the order of the rehearsal."""


@dataclass(frozen=True, slots=True)
class Fault:
    """A fault, and what the software promises of it.

    Parameters
    ----------
    name : str
        Name on the command line.
    promise : str
        The promise, in one line.
    limit_s : float
        Seconds in which it has to be kept.
    play : callable
        Injects the fault on a stage, and notes there what was not held.
    posix : bool
        It needs signals or limits that Windows does not have.
    """

    name: str
    promise: str
    limit_s: float
    play: Callable[[Stage, float], None]
    posix: bool = False

    def rehearse(self) -> Row:
        """Play the fault in processes of its own; return the result."""
        with Stage() as stage:
            try:
                self.play(stage, self.limit_s)
            except (ElsPlusError, OSError, EOFError, TimeoutError, AssertionError) as error:
                stage.problems.append(f"{type(error).__name__}: {error}")
            parked_s = None if stage.parked_s is None else round(stage.parked_s, 3)
            message = "; ".join([*stage.problems, *stage.heard] or [_without_message(parked_s)])
            return Row(
                self.name,
                self.promise,
                not stage.problems,
                parked_s,
                self.limit_s,
                stage.lost,
                stage.lost_silently,
                message,
            )


def _without_message(parked_s: float | None) -> str:
    return "" if parked_s is None else f"clear of the bundle after {parked_s:.2f} s"


def fault(
    name: str, promise: str, limit_s: float, *, posix: bool = False
) -> Callable[[Callable[[Stage, float], None]], Callable[[Stage, float], None]]:
    """Register the function that plays a fault.

    Parameters
    ----------
    name, promise, limit_s, posix
        As of `Fault`.
    """

    def register(play: Callable[[Stage, float], None]) -> Callable[[Stage, float], None]:
        FAULTS[name] = Fault(name, promise, limit_s, play, posix)
        return play

    return register


def faults(names: Sequence[str] = ()) -> list[Fault]:
    """Return the faults of some names, all that this system can play by default.

    Raises
    ------
    InputError
        If there is no fault of a name.
    """
    from napari_elsplus.diagnosis.rehearsal import card_faults, device_faults, engine_faults, process_faults  # noqa: F401

    unknown = [name for name in names if name not in FAULTS]
    if unknown:
        raise InputError(f"there is no fault {unknown[0]}", f"choose of {', '.join(FAULTS)}")
    if names:
        return [FAULTS[name] for name in names]
    return [fault for fault in FAULTS.values() if not (fault.posix and sys.platform == "win32")]


def rehearse(names: Sequence[str] = ()) -> Iterator[Row]:
    """Play faults on the simulated rig, one after the other, each in processes of its own.

    Parameters
    ----------
    names : sequence of str
        Names of the faults; all by default.

    Yields
    ------
    Row
        The result of each fault, as soon as it was played.

    Raises
    ------
    InputError
        If there is no fault of a name.
    """
    for chosen in faults(names):
        yield chosen.rehearse()
