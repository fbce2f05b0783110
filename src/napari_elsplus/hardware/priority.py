"""Priority and core of threads: real time for those that keep the pace of camera and card, where the system allows."""

from __future__ import annotations

import gc
import os
import sys
from contextlib import contextmanager, suppress
from enum import IntEnum
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Iterator

_SWITCH_INTERVAL_S: Final = 2e-4
"""Interval after which a Python thread releases the interpreter's lock; chosen: a 25th of the default, because the
tracking thread acquires the lock after each of its ten or so kernels per frame of 4 ms. With a quarter of it latencies
were alike, and a frame cost 7 % more processor time: each thread that waits wakes as often to request the lock."""

_NEVER: Final = 1 << 30
"""Collections of young objects before a full one; chosen: more than a stream of a year makes."""


class Rank(IntEnum):
    """Priority of a thread in SCHED_RR on Linux: above every thread of ordinary programs, below the kernel's own."""

    REST = 1
    PROCESSING = 2
    CAMERA = 3


def settle_memory() -> None:
    """Exclude all objects that exist now from garbage collection, which stops every thread for tenths of a second.

    To be called when everything is allocated that is needed while frames stream.
    """
    gc.unfreeze()  # what an earlier call excluded may be garbage now, such as the engine of a rig that was closed
    gc.collect()
    gc.freeze()


@contextmanager
def full_collections_deferred() -> Iterator[None]:
    """Collect only young garbage within the context: a full collection stops every thread for 40 to 100 ms."""
    before = gc.get_threshold()
    gc.set_threshold(*before[:2], _NEVER)
    try:
        yield
    finally:
        gc.set_threshold(*before)


def keep_pace() -> bool:
    """Give this thread, and those that it starts from now on, real-time priority.

    Returns
    -------
    bool
        True if the system allowed it: on Linux for root, and with a ``rtprio`` limit of 3 or more.

    Notes
    -----
    All threads of a program should have it: one that waits for the interpreter's lock waits for the slowest of them.
    Linux interrupts for 50 ms a thread that kept a processor busy for 950 ms at this priority.
    """
    sys.setswitchinterval(_SWITCH_INTERVAL_S)
    if sys.platform == "linux":
        with suppress(PermissionError):
            for rank in (Rank.CAMERA, Rank.REST):  # under a lower limit no thread could take its rank later
                os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(rank))
            return True
    return False


def join_frame_core(rank: Rank) -> None:
    """Run this thread on the one core of the threads that hand frames to each other; does nothing without real time.

    Frames are in the caches there, and a thread that wakes another one need not interrupt a second core, which is dear
    on a virtual machine. Threads on one core contend for the interpreter's lock only where one of
    a higher rank wakes.

    Parameters
    ----------
    rank : Rank
        The camera's threads come before processing, so that a frame's time of arrival is right; processing before
        the rest. A thread that this one starts inherits core and rank.
    """
    if sys.platform == "linux" and os.sched_getscheduler(0) == os.SCHED_RR:
        cores = sorted(os.sched_getaffinity(os.getpid()))
        os.sched_setaffinity(0, {cores[os.getpid() % len(cores)]})  # the engines of two rigs seldom share one
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(rank))


def leave_frame_core() -> None:
    """Run this thread, which one of the frames' core has started, on any core, at the lowest rank."""
    if sys.platform == "linux" and os.sched_getscheduler(0) == os.SCHED_RR:
        os.sched_setaffinity(0, os.sched_getaffinity(os.getpid()))
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(Rank.REST))


@contextmanager
def ordinary_priority() -> Iterator[None]:
    """Give this thread ordinary priority within the context, for what takes seconds before frames stream.

    Compiling kernels at real-time priority would starve the processes that guard the galvo.
    """
    if sys.platform == "linux":
        policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        try:
            yield
        finally:
            os.sched_setscheduler(0, policy, parameters)
    else:
        yield
