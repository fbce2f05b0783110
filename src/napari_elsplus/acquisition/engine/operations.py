"""Exclusive operations: one at a time changes the rig; parking interrupts it without waiting for it."""

from __future__ import annotations

import time
from contextlib import contextmanager
from math import inf
from threading import Condition, get_ident
from typing import TYPE_CHECKING

from napari_elsplus.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterator


class Operations:
    """The operation that runs, if any; the thread that runs it may nest further ones.

    Examples
    --------
    >>> operations = Operations()
    >>> with operations.alone("a sweep", long=True):
    ...     operations.running
    'a sweep'
    """

    def __init__(self) -> None:
        self._changed = Condition()
        self._name: str | None = None
        self._owner: int | None = None
        self._long = False
        self._given_s = self._interrupted_s = -inf
        self._reason = ""

    @property
    def running(self) -> str | None:
        """Name of the operation that runs."""
        return self._name

    @contextmanager
    def alone(self, name: str, *, long: bool = False, given_s: float | None = None) -> Iterator[None]:
        """Run an operation while no other one runs.

        Parameters
        ----------
        name : str
            With its article, for messages.
        long : bool
            Others are refused at once while it runs; else they wait for it.
        given_s : float, optional
            When it was commanded, by ``time.perf_counter``; now by default. An interruption after that is one of it,
            also before it runs: it may have waited.

        Raises
        ------
        InputError
            If another operation runs that is long.
        """
        if self._owner == get_ident():
            yield
            return
        given_s = time.perf_counter() if given_s is None else given_s
        with self._changed:
            self._changed.wait_for(lambda: self._name is None or self._long)
            if self._name is not None:
                raise InputError(f"{self._name} is running", "wait until it has ended, or cancel it")
            self._name, self._owner, self._long, self._given_s = name, get_ident(), long, given_s
        try:
            yield
        finally:
            with self._changed:
                self._name = self._owner = None
                self._changed.notify_all()

    def interrupt(self, reason: str) -> None:
        """Make the operations that other threads run, or wait to, fail at their next :meth:`check`, for a reason."""
        if self._owner != get_ident():
            self._reason, self._interrupted_s = reason, time.perf_counter()

    def check(self) -> None:
        """Raise an InputError if the operation of this thread was interrupted."""
        if self._owner == get_ident() and self._interrupted_s > self._given_s:
            raise InputError(f"{self._reason}, so {self._name} has ended", "start it again")
