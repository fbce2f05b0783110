"""Whether this computer has what live work takes: a screen, cores, memory to share, room on the disk."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from napari_elsplus.diagnosis.finding import ok, warning
from napari_elsplus.instrument.optics import PRESETS

if TYPE_CHECKING:
    from collections.abc import Iterator

    from napari_elsplus.diagnosis.finding import Finding

SCREEN_TIMEOUT_S = 60.0
SOFTWARE_RENDERERS = ("llvmpipe", "softpipe", "swrast", "SwiftShader", "GDI Generic", "Microsoft Basic Render")
WITHOUT_SCREEN = "start it on a desktop, through `ssh -X`, or under `xvfb-run`; `napari-elsplus demo` needs no screen"
MIN_RECORDING_S = 60.0
MIN_SHARED_FRAMES = 64
SHARED_MEMORY = Path("/dev/shm")


class Screen(NamedTuple):
    """Whether a window can be opened, and what draws it or why it cannot."""

    answers: bool
    detail: str


def ask_for_screen() -> Screen:
    """Ask Qt, in a process of its own, whether a window with OpenGL can be opened here."""
    probe = [sys.executable, "-m", "napari_elsplus._screen"]
    try:
        done = subprocess.run(probe, capture_output=True, text=True, timeout=SCREEN_TIMEOUT_S, check=False)
    except subprocess.TimeoutExpired:
        return Screen(False, f"the screen has not answered within {SCREEN_TIMEOUT_S:.0f} s")
    said = (done.stdout if done.returncode == 0 else done.stderr).strip().splitlines()
    return Screen(done.returncode == 0, said[0] if said else f"Qt ended with exit code {done.returncode}")


def screen() -> Iterator[Finding]:
    """See that napari could open its window, and that a graphics card draws it."""
    found = ask_for_screen()
    if not found.answers:
        yield warning(f"no window can be opened ({found.detail})", WITHOUT_SCREEN)
    elif any(name in found.detail for name in SOFTWARE_RENDERERS):
        yield warning(f"the processor draws the window ({found.detail})", "install the graphics card's driver")
    else:
        yield ok(f"screen: {found.detail}")


def cores() -> Iterator[Finding]:
    """See that the engine and napari need not share a core."""
    count = os.cpu_count() or 1
    if count < 2:
        yield warning("1 processor core: camera and display will delay each other", "give this computer two or more")
    else:
        yield ok(f"{count} processor cores")


def shared_memory() -> Iterator[Finding]:
    """See that frames can be handed from process to process."""
    if not SHARED_MEMORY.is_dir():
        return
    free = shutil.disk_usage(SHARED_MEMORY).free
    frames = free // max(prod(preset.frame_shape) for preset in PRESETS.values())
    said = f"{free / 2**20:.0f} MiB of shared memory, {frames} full frames"
    if frames < MIN_SHARED_FRAMES:
        yield warning(said, f"mount -o remount,size=1G {SHARED_MEMORY} (for a container: --shm-size=1g)")
    else:
        yield ok(said)


def disk() -> Iterator[Finding]:
    """See how long a recording the disk under the current folder can take."""
    fastest = max(prod(preset.frame_shape) * preset.optics.frame_rate_hz for preset in PRESETS.values())
    free = shutil.disk_usage(Path.cwd()).free
    seconds = free / fastest
    said = f"{free / 2**30:.1f} GiB free in {Path.cwd()}, {seconds / 60:.0f} minutes of recording at the full rate"
    yield ok(said) if seconds >= MIN_RECORDING_S else warning(said, "record to another disk or make room on this one")


CHECKS = (screen, cores, shared_memory, disk)
