"""What a check found: how grave it is, what it is, and how to mend it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Level(StrEnum):
    """How grave a finding is."""

    OK = "ok"
    WARNING = "warning"
    """Something cannot be used; everything else can."""
    PROBLEM = "problem"
    """The software as a whole cannot be relied on."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that a check found.

    Parameters
    ----------
    level : Level
        How grave it is.
    what : str
        What was found, with its value.
    remedy : str, default ""
        The command, or what else to do; every finding that is not ok has one.

    Examples
    --------
    >>> print(Finding(Level.WARNING, "no libusb 1.0", "apt-get install libusb-1.0-0"))
    warning  no libusb 1.0: apt-get install libusb-1.0-0
    """

    level: Level
    what: str
    remedy: str = ""

    def __str__(self) -> str:
        said = f"{self.what}: {self.remedy}" if self.remedy else self.what
        return f"{self.level:<8} {said}"


def ok(what: str) -> Finding:
    """Say that something is as it should be."""
    return Finding(Level.OK, what)


def warning(what: str, remedy: str) -> Finding:
    """Say that something cannot be used, and how it could."""
    return Finding(Level.WARNING, what, remedy)


def problem(what: str, remedy: str) -> Finding:
    """Say that the software cannot be relied on, and how it could."""
    return Finding(Level.PROBLEM, what, remedy)
