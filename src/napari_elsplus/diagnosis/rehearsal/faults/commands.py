"""Commands that cannot be executed, or fail half way, and defects of the engine's own threads."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from napari_elsplus.acquisition.engine.live_images import LiveView
from napari_elsplus.diagnosis.rehearsal.registry import fault
from napari_elsplus.errors import ElsPlusError
from napari_elsplus.workflows.mosaic_plan import MosaicPlan

if TYPE_CHECKING:
    from napari_elsplus.diagnosis.rehearsal.stage import Stage

REFUSED_WITHIN_S = 2.0
"""Seconds in which a command has to be refused; of the promise that no call takes longer."""
EXECUTED_WITHIN_S = 10.0
"""Seconds in which a command that restarts the stream has to end; chosen for a busy computer."""
COMPILED_WITHIN_S = 120.0
"""Seconds for a first use of the tracker, which compiles its kernels; chosen for a busy computer."""
GAIN_DB = 60.0
"""Gain that no camera has."""


@fault("configure-fails", "the settings of before, or unconfigured and refuses to start", EXECUTED_WITHIN_S)
def _configure_fails(stage: Stage, limit_s: float) -> None:
    """Request a frame rate that the camera has, and a gain that it does not have."""
    stage.scan(record=False)
    stage.fault_s = time.perf_counter()
    stage.expect_refused(
        stage.begin("configure", stage.later(frame_rate_hz=100.0, gain_db=GAIN_DB)), "gain", "dB", timeout_s=limit_s
    )
    try:
        stage.call("start")
    except ElsPlusError as refused:
        stage.keep_messages(str(refused))
        time.sleep(0.2)
        stage.expect(not stage.scans(), "the galvo scans although the engine refuses to start")
        return
    stage.wait_for(lambda: stage.status().live, "stream")
    stage.expect_frames_go_on()
    stage.note_exposures()
    assert stage.exposures is not None
    rate_hz = 1 / stage.exposures.period_s
    stage.expect(abs(rate_hz - 240) < 0.5, f"the camera runs at {rate_hz:.0f} Hz, the engine was configured to 240 Hz")
    stage.expect_scanning()


@fault("preset-without-calibration", "refused, with what to do", EXECUTED_WITHIN_S)
def _preset_without_calibration(stage: Stage, limit_s: float) -> None:
    """Choose a preset that the active calibration does not fit, then start."""
    stage.open()
    stage.fault_s = time.perf_counter()
    other = stage.later(preset="120hz")
    try:
        stage.result(stage.begin("configure", other), limit_s)
    except ElsPlusError as refused:
        stage.keep_messages(str(refused))
    else:
        stage.expect_refused(stage.begin("start"), "calibrat", timeout_s=limit_s)
    time.sleep(0.3)
    stage.expect(not stage.scans(), "the galvo scans by a calibration that does not fit")
    stage.call("configure", stage.settings)
    stage.call("start")
    stage.expect_frames_go_on()
    stage.expect_scanning()


@fault("gain-changed-while-recording", "refused, or noted in a recording that goes on", EXECUTED_WITHIN_S)
def _gain_changed_while_recording(stage: Stage, limit_s: float) -> None:
    """Change the gain while frames are recorded."""
    stage.scan()
    stage.fault_s = time.perf_counter()
    try:
        stage.result(stage.begin("configure", stage.later(gain_db=6.0)), limit_s)
    except ElsPlusError as refused:
        stage.keep_messages(str(refused))
        stage.expect("record" in str(refused), f"refused for another reason: {refused}")
    before = stage.status().recorded
    stage.wait_for(lambda: stage.status().recorded > before + 40, "recorded frames after the change", 3.0)
    stage.expect_scanning()
    stage.fault_s = time.perf_counter()
    stage.finish()


@fault("second-procedure", "the second is refused and names the first, which succeeds", REFUSED_WITHIN_S)
def _second_procedure(stage: Stage, limit_s: float) -> None:
    """Start a calibration, then another and a new configuration meanwhile."""
    stage.open()
    first = stage.begin("calibrate_simulated")
    stage.wait_for(lambda: stage.status().progress is not None, "progress")
    stage.fault_s = time.perf_counter()
    stage.expect_refused(stage.begin("calibrate_simulated"), "calibrate simulated", "calibration", timeout_s=limit_s)
    stage.expect_refused(
        stage.begin("configure", stage.later(slit_rows=5)), "calibrate simulated", "calibration", timeout_s=limit_s
    )
    try:
        stage.result(first, 120.0)
    except ElsPlusError as error:
        stage.problems.append(f"the first procedure failed: {error}")


@fault("park-while-busy", "parked within 0.5 s, whatever else is going on", 0.5)
def _park_while_busy(stage: Stage, limit_s: float) -> None:
    """Press Park while live images are made for another view, which takes long."""
    stage.scan()
    stage.switch("delay", "images", 3.0)
    view = stage.begin("show", LiveView())
    time.sleep(0.3)
    stage.fault_s = time.perf_counter()
    park = stage.begin("park")
    stage.expect_parked(limit_s)
    stage.result(park)
    stage.result(view)
    stage.switch("quicken", "images")
    stage.finish()


@fault("recorder-fails", "reported, whole frames kept, the stream goes on", 2.0)
def _recorder_fails(stage: Stage, limit_s: float) -> None:
    """Let the recorder fail with an unexpected error."""
    stage.scan()
    stage.fault("fail", "recorder")
    stage.expect_reported("record", timeout_s=limit_s)
    stage.expect_undisturbed()


@fault("tracker-fails", "reported, frames recorded, the stream goes on", 2.0)
def _tracker_fails(stage: Stage, limit_s: float) -> None:
    """Let the tracker fail with an unexpected error."""
    stage.scan()
    stage.result(stage.begin("track", MosaicPlan()), COMPILED_WITHIN_S)
    stage.fault("fail", "tracker")
    stage.expect_reported("track", timeout_s=limit_s)
    stage.fault_s = time.perf_counter()
    stage.expect_undisturbed()
