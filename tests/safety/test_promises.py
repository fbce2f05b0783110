"""The promises of safety, from outside: each fault is rehearsed, and the card's log and the recorded file judge."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from napari_elsplus.diagnosis.rehearsal.rehearse import faults

COMMAND = (sys.executable, "-c", "from napari_elsplus.cli import main; main()", "rehearse")
COLUMNS = [
    "fault", "promise", "held", "parked_s", "limit_s", "frames_lost", "frames_lost_silently", "message",
]  # fmt: skip
SHORT = {"strobe-never-wired", "engine-killed", "window-frozen", "configure-fails"}
"""Rehearsed by default; chosen: a fault of a wire, one of each process, and one of a command."""
BROKEN: dict[str, str] = {}
"""Promises that are not held, and the room that has to change."""
LIMITS_S = {
    "strobe-lost": 0.5, "strobe-never-wired": 0.5, "engine-killed": 0.5, "window-killed": 0.5, "camera-unplugged": 0.5,
    "guardian-killed": 1.0, "guardian-stopped": 1.0, "disconnect-while-live": 0.5, "card-refuses-while-closing": 0.8,
    "engine-stopped": 2.5, "ramps-without-frames": 1.5, "card-refuses-long-while-closing": 3.5,
}  # fmt: skip
"""Seconds, of the promises; from the fault, so that a card that refuses for 0.3 s or 3 s has that time, too."""


def marked(name: str) -> object:
    marks = [] if name in SHORT else [pytest.mark.slow]
    if name in BROKEN:
        marks.append(pytest.mark.xfail(strict=True, reason=BROKEN[name]))
    return pytest.param(name, marks=marks)


@pytest.mark.parametrize("name", [marked(fault.name) for fault in faults()])
def test_a_promise_is_held(name: str) -> None:
    (fault,) = faults([name])
    row = fault.rehearse()
    assert row.held, row.message
    assert row.frames_lost_silently == 0
    assert row.limit_s == LIMITS_S.get(name, row.limit_s)
    assert row.parked_s is None or 0 <= row.parked_s <= row.limit_s


def rehearse(*arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*COMMAND, *map(str, arguments)], capture_output=True, text=True, timeout=240)


def test_the_command_writes_a_table_and_a_report(tmp_path: Path) -> None:
    report = tmp_path / "rehearsal.json"
    done = rehearse("--fault", "camera-unplugged", "--fault", "bad-trailers", "--report", report)
    assert done.returncode == 0, done.stdout + done.stderr
    first, second = json.loads(report.read_text())
    assert list(first) == list(second) == COLUMNS
    assert first["fault"] == "camera-unplugged"
    assert 0 < first["parked_s"] <= first["limit_s"] == 0.5
    assert second["parked_s"] is None
    assert second["frames_lost"] >= 5
    assert second["frames_lost_silently"] == 0
    assert "unplugged" in done.stdout
    again = rehearse("--fault", "bad-trailers", "--report", report)
    assert again.returncode == 2
    assert len(again.stderr.strip().splitlines()) == 1


def test_an_unknown_fault_is_one_line() -> None:
    done = rehearse("--fault", "earthquake")
    assert done.returncode == 2
    assert done.stdout == ""
    (line,) = done.stderr.strip().splitlines()
    assert "earthquake" in line
    assert "strobe-lost" in line


def test_the_rehearsal_judges_and_does_not_believe(monkeypatch: pytest.MonkeyPatch) -> None:
    """A guardian that does nothing is found out: the line stays on the bundle when the engine is killed."""
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parent / "without_guardian"), prepend=":")
    (fault,) = faults(["engine-killed"])
    row = fault.rehearse()
    assert not row.held
    assert row.parked_s is not None
    assert row.parked_s > row.limit_s
    assert "still on the bundle" in row.message
