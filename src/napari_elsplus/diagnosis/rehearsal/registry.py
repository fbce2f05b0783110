"""Registry of rehearsed faults, each a function of a stage."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from napari_elsplus.diagnosis.rehearsal.row import Row
from napari_elsplus.diagnosis.rehearsal.stage import Stage
from napari_elsplus.errors import ElsPlusError

if TYPE_CHECKING:
    from collections.abc import Callable

    Play = Callable[[Stage, float], None]

FAULTS: Final[dict[str, RehearsedFault]] = {}
"""Every fault by its name, in the order of the rehearsal."""


@dataclass(frozen=True, slots=True)
class RehearsedFault:
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
    play: Play
    posix: bool = False

    def rehearse(self) -> Row:
        """Play the fault in processes of its own; return the result."""
        with Stage() as stage:
            try:
                self.play(stage, self.limit_s)
            except (ElsPlusError, OSError, EOFError, TimeoutError, AssertionError) as error:
                stage.problems.append(f"{type(error).__name__}: {error}")
            parked_s = None if stage.parked_s is None else round(stage.parked_s, 3)
            cleared = "" if parked_s is None else f"clear of the bundle after {parked_s:.2f} s"
            message = "; ".join([*stage.problems, *stage.messages]) or cleared
            lost = stage.lost, stage.lost_silently
            return Row(self.name, self.promise, not stage.problems, parked_s, self.limit_s, *lost, message)


def fault(name: str, promise: str, limit_s: float, *, posix: bool = False) -> Callable[[Play], Play]:
    """Register the function that plays a fault.

    Parameters
    ----------
    name, promise, limit_s, posix
        As of `RehearsedFault`.
    """

    def register(play: Play) -> Play:
        FAULTS[name] = RehearsedFault(name, promise, limit_s, play, posix)
        return play

    return register
