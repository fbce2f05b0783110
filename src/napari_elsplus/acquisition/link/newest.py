"""The newest of values that come faster than anybody looks."""

from __future__ import annotations

from threading import Condition
from typing import Generic, TypeVar

T = TypeVar("T")


class Newest(Generic[T]):
    """Holds the newest value for whoever waits for one; what nobody saw in time is lost.

    Examples
    --------
    >>> newest = Newest()
    >>> newest.put("first"); newest.put("second")
    >>> newest.after(0), newest.after(2, patience_s=0.01)
    ((2, 'second'), None)
    """

    def __init__(self) -> None:
        self._come = Condition()
        self._number = 0
        self._value: T | None = None

    def put(self, value: T) -> None:
        """Replace the value."""
        with self._come:
            self._value = value
            self._number += 1
            self._come.notify_all()

    def after(self, number: int, patience_s: float = 0.5) -> tuple[int, T] | None:
        """Wait for a value that is newer than that number; return it with its own, None if none comes."""
        with self._come:
            if not self._come.wait_for(lambda: self._number > number, patience_s) or self._value is None:
                return None
            return self._number, self._value
