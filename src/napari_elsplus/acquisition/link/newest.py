"""The newest of values that come faster than they are read."""

from __future__ import annotations

from threading import Condition
from typing import Generic, TypeVar

T = TypeVar("T")


class Newest(Generic[T]):
    """Holds the newest value for readers that wait for one; older ones are lost.

    Examples
    --------
    >>> newest = Newest()
    >>> newest.put("first"); newest.put("second")
    >>> newest.after(0), newest.after(2, timeout_s=0.01)
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

    def after(self, number: int, timeout_s: float = 0.5) -> tuple[int, T] | None:
        """Wait for a value after a number; return it with its own number, None if none comes within the timeout."""
        with self._come:
            if not self._come.wait_for(lambda: self._number > number, timeout_s) or self._value is None:
                return None
            return self._number, self._value
