from __future__ import annotations

import os
import sys

import pytest

from napari_elsplus.hardware.priority import keep_pace, ordinary_priority


@pytest.mark.skipif(sys.platform != "linux", reason="policies of scheduling are those of Linux")
def test_priority_is_ordinary_within_the_context_and_as_before_after_it() -> None:
    interval_s = sys.getswitchinterval()
    policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)  # earlier tests may have raised it
    try:
        if not keep_pace():
            pytest.skip("this user may not have real-time priority")
        with ordinary_priority():
            assert os.sched_getscheduler(0) == os.SCHED_OTHER
        assert os.sched_getscheduler(0) == os.SCHED_RR
    finally:
        os.sched_setscheduler(0, policy, parameters)
        sys.setswitchinterval(interval_s)
