"""Checks of the computer for live work: screen, cores, shared memory, disk."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from napari_elsplus.diagnosis.finding import Finding, ok, warning
from napari_elsplus.instrument.optics import PRESETS

if TYPE_CHECKING:
    from collections.abc import Iterator


SCREEN_TIMEOUT_S = 60.0
"""Seconds; chosen for a slow remote screen."""
SOFTWARE_RENDERERS = ("llvmpipe", "softpipe", "swrast", "SwiftShader", "GDI Generic", "Microsoft Basic Render")
"""Parts of the names by which OpenGL renderers without a graphics card report themselves."""
WITHOUT_SCREEN = "start it on a desktop, through `ssh -X`, or under `xvfb-run`; `napari-elsplus demo` needs no screen"
"""Remedy where no window can be opened."""
MIN_RECORDING_S = 60.0
"""Seconds of recording at the full rate; chosen."""
MIN_SHARED_FRAMES = 64
"""Frames at full size; chosen: a ring of raw and displayed images."""
SHARED_MEMORY = Path("/dev/shm")


class Screen(NamedTuple):
    """Result of opening a window: success, and what draws it or why it failed."""

    answers: bool
    detail: str


def probe_screen() -> Screen:
    """Open a window with OpenGL in a process of its own."""
    probe = [sys.executable, "-m", "napari_elsplus._screen"]
    try:
        done = subprocess.run(probe, capture_output=True, text=True, timeout=SCREEN_TIMEOUT_S, check=False)
    except subprocess.TimeoutExpired:
        return Screen(False, f"the screen has not answered within {SCREEN_TIMEOUT_S:.0f} s")
    text = (done.stdout if done.returncode == 0 else done.stderr).strip().splitlines()
    return Screen(done.returncode == 0, text[0] if text else f"Qt ended with exit code {done.returncode}")


def screen() -> Iterator[Finding]:
    """Check that napari could open its window, and that a graphics card draws it."""
    found = probe_screen()
    if not found.answers:
        yield warning(f"no window can be opened ({found.detail})", WITHOUT_SCREEN)
    elif any(name in found.detail for name in SOFTWARE_RENDERERS):
        yield warning(f"the processor draws the window ({found.detail})", "install the graphics card's driver")
    else:
        yield ok(f"screen: {found.detail}")


def cores() -> Iterator[Finding]:
    """Check that engine and napari need not share a core."""
    count = os.cpu_count() or 1
    if sys.platform == "linux":
        count = len(os.sched_getaffinity(0))
    if count < 2:
        yield warning("1 processor core: camera and display will delay each other", "give this computer two or more")
    else:
        yield ok(f"{count} processor cores")


def shared_memory() -> Iterator[Finding]:
    """Check that frames can be passed between processes."""
    if not SHARED_MEMORY.is_dir():
        return
    free = shutil.disk_usage(SHARED_MEMORY).free
    frames = free // max(prod(preset.frame_shape) for preset in PRESETS.values())
    text = f"{free / 2**20:.0f} MiB of shared memory, {frames} full frames"
    if frames < MIN_SHARED_FRAMES:
        yield warning(text, f"mount -o remount,size=1G {SHARED_MEMORY} (for a container: --shm-size=1g)")
    else:
        yield ok(text)


def disk() -> Iterator[Finding]:
    """Check how long a recording fits on the disk of the current folder."""
    fastest = max(prod(preset.frame_shape) * preset.optics.frame_rate_hz for preset in PRESETS.values())
    free = shutil.disk_usage(Path.cwd()).free
    seconds = free / fastest
    text = f"{free / 2**30:.1f} GiB free in {Path.cwd()}, {seconds / 60:.0f} minutes of recording at the full rate"
    yield ok(text) if seconds >= MIN_RECORDING_S else warning(text, "record to another disk or make room on this one")


CHECKS = (screen, cores, shared_memory, disk)
"""Checks of this module, in order."""
