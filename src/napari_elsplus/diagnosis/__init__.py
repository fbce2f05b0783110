"""Checks of installation, devices and computer: what is there, what is wrong, and its remedy."""

from __future__ import annotations

from typing import TYPE_CHECKING

from napari_elsplus.diagnosis import devices, machine, software

if TYPE_CHECKING:
    from collections.abc import Iterator

    from napari_elsplus.diagnosis.finding import Finding

CHECKS = (*software.CHECKS, *machine.CHECKS, *devices.CHECKS)
"""Every check, from the software to the devices; each is called without arguments and yields findings."""


def diagnose() -> Iterator[Finding]:
    """Run every check, and yield each finding as soon as it is made.

    Yields
    ------
    Finding
        At least one for each check.

    Examples
    --------
    >>> next(diagnose()).what
    'Python 3...'
    """
    for check in CHECKS:
        yield from check()
