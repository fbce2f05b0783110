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

SWALLOWED = """
import os, signal, time
from napari_elsplus.closing import unwound_by_signals

try:
    with unwound_by_signals(interrupts=True):
        try:
            os.kill(os.getpid(), signal.{name})
            time.sleep(600)
        except BaseException:
            pass
        time.sleep(600)
        print("went on")
finally:
    print("unwound")
"""

UNDISTURBED = """
import os, signal, time
from napari_elsplus.closing import unwound_by_signals

with unwound_by_signals(interrupts=True):
    try:
        os.kill(os.getpid(), signal.{name})
        time.sleep(600)
    finally:
        try:
            raise OSError("while it unwinds")
        except OSError:
            os.kill(os.getpid(), signal.{name})
            time.sleep(2)
        print("unwound")
"""


@pytest.mark.skipif(os.name != "posix", reason="signals as POSIX has them")
@pytest.mark.parametrize(("name", "code"), [("SIGTERM", 143), ("SIGINT", 130)])
@pytest.mark.parametrize("text", [SWALLOWED, UNDISTURBED], ids=["swallowed", "undisturbed"])
def test_a_signal_whose_exception_is_swallowed_ends_the_program_and_further_ones_do_not_disturb_its_end(
    name: str, code: int, text: str
) -> None:
    """Before: swallowed, as by an import of matplotlib, it left a program that was deaf to further signals."""
    program = [sys.executable, "-c", text.format(name=name)]
    done = subprocess.run(program, capture_output=True, text=True, timeout=20)
    assert done.stdout == "unwound\n"
    assert done.returncode in (code, -getattr(signal, name))


@pytest.mark.skipif(os.name != "posix", reason="signals as POSIX has them")
@pytest.mark.parametrize(("name", "code"), [("SIGTERM", 143), ("SIGINT", 130)])
def test_a_signal_that_arrives_in_a_finalizer_ends_the_program_all_the_same(name: str, code: int) -> None:
    """Before: Python discarded the exception, and the program went on, deaf to further signals."""
    program = [sys.executable, "-c", DISCARDED.format(name=name)]
    done = subprocess.run(program, capture_output=True, text=True, timeout=60)
    assert (done.stdout, "Exception ignored" in done.stderr) == ("unwound\n", False)
    assert done.returncode in (code, -getattr(signal, name))
