"""A finding of a check: severity, subject, remedy."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Level(StrEnum):
    """Severity of a finding."""

    OK = "ok"
    WARNING = "warning"
    """Something cannot be used; everything else can."""
    PROBLEM = "problem"
    """The software as a whole cannot be relied on."""


@dataclass(frozen=True, slots=True)
class Finding:
    """A finding of a check.

    Parameters
    ----------
    level : Level
        Severity.
    what : str
        What was found, with its value.
    remedy : str, default ""
        Command or action; every finding that is not ok has one.

    Examples
    --------
    >>> print(Finding(Level.WARNING, "no libusb 1.0", "apt-get install libusb-1.0-0"))
    warning  no libusb 1.0: apt-get install libusb-1.0-0
    """

    level: Level
    what: str
    remedy: str = ""

    def __str__(self) -> str:
        text = f"{self.what}: {self.remedy}" if self.remedy else self.what
        return f"{self.level:<8} {text}"


def ok(what: str) -> Finding:
    """Return a finding of no fault, with `what` was found."""
    return Finding(Level.OK, what)


def warning(what: str, remedy: str) -> Finding:
    """Return a finding that a part cannot be used: `what`, and its remedy."""
    return Finding(Level.WARNING, what, remedy)


def problem(what: str, remedy: str) -> Finding:
    """Return a finding that the software cannot be relied on: `what`, and its remedy."""
    return Finding(Level.PROBLEM, what, remedy)
