"""Priority over other programs, where the system allows it: a frame waits for nobody."""

from __future__ import annotations

import gc
import os
import sys
from contextlib import suppress
from typing import Final

_LEAST_REAL_TIME: Final = 1
_SWITCH_INTERVAL_S: Final = 5e-5
"""Threads that compute in Python hand over after so long, a hundredth of the interpreter's default: the one that tracks
asks for the interpreter's lock after each of its ten or so kernels."""


def settle_memory() -> None:
    """Leave what exists now out of all later searches for garbage, which hold up every thread for tenths of a second.

    To be called once in a process, when all is there that will be needed while frames stream.
    """
    gc.collect()
    gc.freeze()


def keep_pace() -> bool:
    """Put this thread, and those that it starts from now on, before ordinary programs.

    Returns
    -------
    bool
        Whether the system allowed it: on Linux root may, and whoever has a ``rtprio`` limit.

    Notes
    -----
    All threads of a program should have it: one that waits for the interpreter's lock waits for the slowest of them.
    Linux stops for 50 ms what has kept a processor busy for 950 ms in this way.
    """
    sys.setswitchinterval(_SWITCH_INTERVAL_S)
    if sys.platform != "linux":
        return False
    with suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(_LEAST_REAL_TIME))
        return True
    return False
