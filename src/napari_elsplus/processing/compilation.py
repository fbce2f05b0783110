"""Reports of kernels that are being compiled, for programs in which somebody waits; imports no compiler."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    Report = Callable[[str], None]

_REPORTS: Final[list[Report]] = []


@contextmanager
def reported_compilation(report: Report) -> Iterator[None]:
    """Report the kernels that are compiled within the context, in any thread; those in the cache are not compiled.

    Parameters
    ----------
    report : callable
        Receives the name of a kernel when its compilation begins, and an empty string when it has ended. Kernels that
        it calls are compiled meanwhile.
    """
    _REPORTS.append(report)
    try:
        yield
    finally:
        _REPORTS.remove(report)


def report_compilation(kernel: str) -> None:
    """Pass the name of a `kernel`, or an empty string at the end of its compilation, to whoever waits."""
    for report in _REPORTS:
        report(kernel)


def compilation_remark(kernel: str) -> str:
    """Return what is displayed while a `kernel` is compiled; an empty string for an empty name."""
    return f"compiling {kernel}, once after an installation" if kernel else ""
