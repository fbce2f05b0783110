from __future__ import annotations

import os
import subprocess
import sys
from collections import namedtuple

import pytest

from napari_elsplus.diagnosis import machine
from napari_elsplus.diagnosis.finding import Level
from napari_elsplus.diagnosis.machine import Screen, probe_screen

Usage = namedtuple("Usage", "total used free")


def said(probe: str, monkeypatch: pytest.MonkeyPatch) -> Screen:
    """What is made of a probe that runs this code."""
    real = subprocess.run
    monkeypatch.setattr(subprocess, "run", lambda command, **options: real([sys.executable, "-c", probe], **options))
    return probe_screen()


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="elsewhere no variable names the display")
def test_no_display_is_said_as_such(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "QT_QPA_PLATFORM"):
        monkeypatch.delenv(name, raising=False)
    assert probe_screen() == Screen(False, "neither DISPLAY nor WAYLAND_DISPLAY is set")


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only X11 displays are numbered")
def test_a_display_that_does_not_answer_is_no_screen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DISPLAY", ":7654")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setenv("QT_QPA_PLATFORM", "xcb")
    assert not probe_screen().answers


def test_a_platform_that_nobody_sees_is_no_screen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("QT_QPA_PLATFORM", "offscreen")
    found = probe_screen()
    assert not found.answers
    assert "offscreen" in found.detail


@pytest.mark.skipif(not hasattr(os, "abort") or os.name == "nt", reason="Windows shows a dialogue instead")
def test_a_probe_that_is_aborted_is_no_screen(monkeypatch: pytest.MonkeyPatch) -> None:
    found = said("import os, sys; print('no such plugin', file=sys.stderr, flush=True); os.abort()", monkeypatch)
    assert found == Screen(False, "no such plugin")


def test_a_screen_that_hangs_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "SCREEN_TIMEOUT_S", 0.3)
    found = said("import time; time.sleep(30)", monkeypatch)
    assert not found.answers
    assert "not answered" in found.detail


@pytest.mark.parametrize(
    ("screen", "level"),
    [
        (Screen(True, "xcb, OpenGL 4.6 on NVIDIA RTX A2000"), Level.OK),
        (Screen(True, "xcb, OpenGL 4.5 on llvmpipe (LLVM 15)"), Level.WARNING),
        (Screen(False, "could not connect to display :3"), Level.WARNING),
    ],
)
def test_a_screen_is_judged_by_what_draws_it(screen: Screen, level: Level, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "probe_screen", lambda: screen)
    (finding,) = machine.screen()
    assert finding.level is level
    assert screen.detail in finding.what


def test_a_minute_of_recording_must_fit_on_the_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    bytes_per_minute = 60 * 120 * 1048 * 1328
    for free, level in ((0.99 * bytes_per_minute, Level.WARNING), (1.01 * bytes_per_minute, Level.OK)):
        monkeypatch.setattr(machine.shutil, "disk_usage", lambda _, free=free: Usage(0, 0, free))
        (finding,) = machine.disk()
        assert finding.level is level


def test_the_shared_memory_of_a_plain_container_is_too_small(monkeypatch: pytest.MonkeyPatch, tmp_path: object) -> None:
    monkeypatch.setattr(machine, "SHARED_MEMORY", tmp_path)
    monkeypatch.setattr(machine.shutil, "disk_usage", lambda _: Usage(0, 0, 64 * 2**20))
    (finding,) = machine.shared_memory()
    assert finding.level is Level.WARNING


def test_one_core_is_warned_of(monkeypatch: pytest.MonkeyPatch) -> None:
    """Before: a program that may use one of several was said to have all of them."""
    monkeypatch.setattr(os, "cpu_count", lambda: 4 if sys.platform == "linux" else 1)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {3}, raising=False)
    (finding,) = machine.cores()
    assert finding.level is Level.WARNING
