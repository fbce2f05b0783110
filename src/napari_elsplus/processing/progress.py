"""The type of what displays the progress of a loop, or cancels it."""

from __future__ import annotations

from collections.abc import Callable, Iterable

ProgressWrapper = Callable[[Iterable[int]], Iterable[int]]
"""Wraps the numbers of a loop and returns them; ``iter`` where no progress is displayed."""
