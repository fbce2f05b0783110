"""The protocol by which whole jobs report their progress."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from collections.abc import Iterable


class Progress(Protocol):
    """Wraps the numbers of a loop to display how far it is: ``tqdm.tqdm`` and ``rich.progress.track`` are such."""

    def __call__(self, numbers: Iterable[int], step: str, /) -> Iterable[int]:
        """Return the numbers, unchanged.

        Parameters
        ----------
        numbers : iterable of int
            What the loop goes through; it has a length.
        step : str
            Name of the step.
        """


def without_display(numbers: Iterable[int], step: str, /) -> Iterable[int]:
    """Return the numbers of a step: the default where no progress is displayed."""
    return numbers
