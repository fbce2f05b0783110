"""Result of one rehearsed fault."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any


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

    def content(self) -> dict[str, Any]:
        """Return the row ready for JSON."""
        return asdict(self)
