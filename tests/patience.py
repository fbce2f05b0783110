"""Limits of devices for tests that are not about limits: a busy computer is no device that does not answer.

The tests of the hardware and of safety keep the limits of the drivers.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pkgutil import resolve_name

LONG_S = {
    "daq.calls.STUCK_S": 30.0,
    "daq.calls.GIVE_UP_S": 60.0,
    "daq.interlock.NO_FRAMES_S": 30.0,
    "daq.scanner.PARK_TIMEOUT_S": 60.0,
    "daq.scanner.CLOSE_TIMEOUT_S": 60.0,
    "guardian.supervision.SILENT_S": 30.0,
    "guardian.supervision.REPLACE_WITHIN_S": 30.0,
}
"""Seconds that a test may wait for the virtual card, the camera's frames and the guardian, by the limit's name."""


def be_patient(set_limit: Callable[[object, str, float], None] = setattr) -> None:
    """Give each limit its long value: for good by default, else by a function of module, name and value."""
    for module, limit, seconds in _limits():
        set_limit(module, limit, seconds)


@cache
def _limits() -> list[tuple[object, str, float]]:
    places = [(name.rpartition("."), seconds) for name, seconds in LONG_S.items()]
    limits = [(resolve_name(f"napari_elsplus.hardware.{place}"), limit, s) for (place, _, limit), s in places]
    assert all(hasattr(module, limit) for module, limit, _ in limits)
    return limits
