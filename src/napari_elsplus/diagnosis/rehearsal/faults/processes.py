"""Faults of processes: window, engine, guardian, a script."""

from __future__ import annotations

import os
import signal
import sys
import time
from functools import partial
from typing import Final

from napari_elsplus.acquisition.link.messages import HEARTBEAT_TIMEOUT_S
from napari_elsplus.diagnosis.rehearsal.registry import fault
from napari_elsplus.diagnosis.rehearsal.stage import KILL, Stage, ends_within
from napari_elsplus.hardware.guardian.process import STANDSTILL_S

GUARDIAN_WITHIN_S: Final = 1.0
"""Seconds in which a guardian that was killed is replaced, or the galvo parked; of the promises."""
DISCONNECTS: Final = 5
"""Times that the window disconnects; chosen: some seconds each. The tests do so 300 times."""


@fault("window-killed", "parked within 0.5 s, the recording finished, nothing left", 0.5)
def _window_killed(stage: Stage, limit_s: float) -> None:
    """Kill the window's process."""
    stage.scan()
    stage.note_exposures()
    stage.status()
    stage.window_process.kill()
    stage.fault_s = time.perf_counter()
    stage.expect_parked(limit_s)
    ended = ends_within(stage.engine_pid, 10.0)
    stage.expect(ended, "the engine's process did not end")
    if ended:
        stage.engine_pid = 0
    stage.expect_recording()


@fault("disconnect-while-live", "parked within 0.5 s, no crash of the window that copies images, every time", 0.5)
def _disconnect_while_live(stage: Stage, limit_s: float) -> None:
    """Disconnect while the window copies every image, and connect again, several times."""
    parked_s = []
    for number in range(DISCONNECTS):
        if number:
            stage.connect()
        stage.scan(record=False)
        stage.copy_images()
        stage.fault_s = time.perf_counter()
        stage.close()
        stage.expect_parked(limit_s)
        stage.expect(ends_within(stage.engine_pid, 5.0), "the engine's process did not end")
        parked_s.append(stage.parked_s or 0.0)
    stage.parked_s = max(parked_s)


@fault("engine-killed", "parked within 0.5 s by the guardian, whole frames kept, reported", 0.5)
def _engine_killed(stage: Stage, limit_s: float) -> None:
    """Kill the engine's process."""
    stage.scan()
    stage.note_exposures()
    stage.status()
    stage.kill_engine()
    stage.fault_s = time.perf_counter()
    stage.expect_parked(limit_s)
    stage.expect_reported("engine's process ended")
    stage.expect_recording(complete=False)


@fault(
    "engine-stopped",
    "parked by the guardian within 0.5 s after 2 s without a heartbeat, frames kept, reported",
    STANDSTILL_S + 0.5,
    posix=True,
)
def _engine_stopped(stage: Stage, limit_s: float) -> None:
    """Stop the engine's process, without ending it, as a defect that never returns does; then let it go on."""
    if sys.platform != "win32":
        stage.scan()
        stage.note_exposures()
        stage.status()
        os.kill(stage.engine_pid, signal.SIGSTOP)
        stage.fault_s = time.perf_counter()
        try:
            stage.expect_parked(limit_s)
        finally:
            os.kill(stage.engine_pid, signal.SIGCONT)
        stage.expect_reported("stood still")
        stage.call("stop")
        stage.wait_for(lambda: not getattr(stage.status().recording, "running", False), "end of the recording")
        stage.expect_recording()


def _guardian_lost(stage: Stage, limit_s: float, by: signal.Signals) -> None:
    """Kill or stop the guardian `by` a signal; after its time, if another is on guard, kill the engine, too."""
    stage.scan()
    stage.note_exposures()
    first, _ = stage.switch("guardian")
    os.kill(first, by)
    stage.fault_s = lost_s = time.perf_counter()
    time.sleep(limit_s)
    now, on_guard = stage.switch("guardian")
    replaced = on_guard and now != first
    stage.expect_reported("guardian")
    if not replaced:
        stage.expect_parked(limit_s)
        stage.finish()
        return
    stage.expect_frames_go_on()
    stage.note_exposures()
    stage.kill_engine()
    stage.fault_s = time.perf_counter()
    stage.expect_parked(0.5)
    stage.expect_recording(complete=False)
    stage.keep_messages(f"replaced; after {stage.fault_s - lost_s:.1f} s the engine was killed, and it parked")


fault("guardian-killed", "replaced or parked within 1 s, reported", GUARDIAN_WITHIN_S)(partial(_guardian_lost, by=KILL))
if sys.platform != "win32":
    stopped = partial(_guardian_lost, by=signal.SIGSTOP)
    fault("guardian-stopped", "replaced or parked within 1 s, reported", GUARDIAN_WITHIN_S, posix=True)(stopped)


@fault("script-without-guardian", "parked within 0.5 s by the guardian that every open rig has", 0.5)
def _script_without_guardian(stage: Stage, limit_s: float) -> None:
    """Kill a script that scans with a rig which it opened, and started no guardian."""
    script = stage.start([sys.executable, "-m", "napari_elsplus.diagnosis.rehearsal.script"])
    try:
        stage.accept_engine()
        stage.wait_for(stage.scans, "scan of the script", 60.0)
        script.kill()
        stage.engine_pid = 0
        stage.fault_s = time.perf_counter()
        stage.expect_parked(limit_s)
    finally:
        script.kill()
        script.wait()


@fault(
    "window-frozen",
    "parked within 0.5 s after the timeout of the heartbeat, frames kept, reported",
    HEARTBEAT_TIMEOUT_S + 0.5,
    posix=True,
)
def _window_frozen(stage: Stage, limit_s: float) -> None:
    """Stop the window's process, without ending it."""
    if sys.platform != "win32":
        stage.scan()
        stage.status()
        os.kill(stage.window_process.pid, signal.SIGSTOP)
        stage.fault_s = time.perf_counter()
        try:
            stage.expect_parked(limit_s)
            stage.note_exposures()
        finally:
            os.kill(stage.window_process.pid, signal.SIGCONT)
        stage.expect_reported("heartbeat", "window")
        stage.finish()
