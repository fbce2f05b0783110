"""What is installed, what is connected, what is wrong, and the command that mends it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from napari_elsplus.diagnosis import devices, machine, software

if TYPE_CHECKING:
    from collections.abc import Iterator

    from napari_elsplus.diagnosis.finding import Finding

CHECKS = (*software.CHECKS, *machine.CHECKS, *devices.CHECKS)
"""Every check, in the order in which a person would ask: each is called without arguments and gives its findings."""


def diagnose() -> Iterator[Finding]:
    """Run every check, one after the other, and give what each finds as it finds it.

    Returns
    -------
    Iterator of Finding
        At least one for each check.

    Examples
    --------
    >>> next(diagnose()).what
    'Python 3...'
    """
    for check in CHECKS:
        yield from check()
