"""Result of one rehearsed fault."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Row:
    """Result of one rehearsed fault.

    Parameters
    ----------
    fault : str
        Name of the fault.
    promise : str
        What the software promises.
    held : bool
        True if all of it was observed.
    parked_s : float, optional
        Seconds, on the card's clock, from the fault to the galvo clear of the bundle for good; the time observed, if
        it was never clear. None where parking is not promised.
    limit_s : float
        Seconds in which the promise has to be kept.
    frames_lost : int
        Frames that the camera took before the fault and that are not in the recording.
    frames_lost_silently : int
        Those of them that were not reported.
    message : str
        What the software reported, or what was not held.
    """

    fault: str
    promise: str
    held: bool
    parked_s: float | None
    limit_s: float
    frames_lost: int
    frames_lost_silently: int
    message: str


COLUMNS = "{:<33}{:<5}{:>9}{:>9}{:>6}{:>10}  {}"
"""Format of the printed table."""


def heading() -> str:
    """Return the heading of the printed table."""
    return COLUMNS.format("fault", "held", "parked s", "limit s", "lost", "silently", "message")


def line(row: Row) -> str:
    """Return a row of the printed table."""
    parked = "-" if row.parked_s is None else f"{row.parked_s:.3f}"
    held = "yes" if row.held else "NO"
    return COLUMNS.format(
        row.fault, held, parked, f"{row.limit_s:.1f}", row.frames_lost, row.frames_lost_silently, row.message
    )
