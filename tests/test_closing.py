"""Signals end a program in order, wherever they arrive."""

from __future__ import annotations

import os
import signal
import subprocess
import sys

import pytest

DISCARDED = """
import os, signal, time
from napari_elsplus.closing import unwound_by_signals

class Finalized:
    def __del__(self):
        os.kill(os.getpid(), signal.{name})
        time.sleep(0.1)

try:
    with unwound_by_signals(interrupts=True):
        held = Finalized()
        del held
        time.sleep(600)
        print("went on")
finally:
    print("unwound")
"""


@pytest.mark.skipif(os.name != "posix", reason="signals as POSIX has them")
@pytest.mark.parametrize(("name", "code"), [("SIGTERM", 143), ("SIGINT", 130)])
def test_a_signal_that_arrives_in_a_finalizer_ends_the_program_all_the_same(name: str, code: int) -> None:
    """Before: Python discarded the exception, and the program went on, deaf to further signals."""
    program = [sys.executable, "-c", DISCARDED.format(name=name)]
    done = subprocess.run(program, capture_output=True, text=True, timeout=60)
    assert (done.stdout, "Exception ignored" in done.stderr) == ("unwound\n", False)
    assert done.returncode in (code, -getattr(signal, name))
