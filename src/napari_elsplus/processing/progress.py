"""Progress of loops and whole jobs: what wraps the numbers that a loop goes through, to display or to cancel it."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Protocol

ProgressWrapper = Callable[[Iterable[int]], Iterable[int]]
"""Wraps the numbers of one loop and returns them; ``iter`` where no progress is displayed."""


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
