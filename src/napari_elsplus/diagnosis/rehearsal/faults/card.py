"""Faults of the card that drives the galvo, and of the wire that triggers it."""

from __future__ import annotations

import time
from functools import partial

from napari_elsplus.diagnosis.rehearsal.registry import fault
from napari_elsplus.diagnosis.rehearsal.stage import Stage, ends_within
from napari_elsplus.hardware.daq.interlock import NO_FRAMES_S

SHORT_S, LONG_S = 0.3, 3.0
"""Seconds for which the card refuses every call."""
PARKED_WITHIN_S = 0.5
"""Seconds in which the galvo has to be clear of the bundle; of the promises."""
ENDLESS = 10**9
"""Frames; more than any rehearsal lasts."""


@fault("strobe-lost", "parked within 0.5 s, recording kept, reported", PARKED_WITHIN_S)
def _strobe_lost(stage: Stage, limit_s: float) -> None:
    """Cut the wire of the strobe while scanning."""
    stage.scan()
    stage.fault("cut_strobe")
    stage.expect_parked(limit_s)
    stage.expect_reported("strobe")
    stage.finish()


@fault("strobe-never-wired", "parked within 0.5 s after the first frame, names the wire", PARKED_WITHIN_S)
def _strobe_never_wired(stage: Stage, limit_s: float) -> None:
    """Start without a wire from the camera's strobe to the card."""
    stage.open()
    stage.log.card.inject(strobe_unwired=True)
    stage.call("start")
    stage.wait_for(lambda: stage.switch("exposures") is not None, "frames")
    stage.note_exposures()
    assert stage.exposures is not None
    stage.fault_s = stage.exposures.first_read_out_s
    stage.expect_parked(limit_s)
    stage.expect_reported("PFI", "strobe")


@fault("ramps-without-frames", "parked within 0.5 s after 1 s without a frame, reported", NO_FRAMES_S + PARKED_WITHIN_S)
def _ramps_without_frames(stage: Stage, limit_s: float) -> None:
    """Let the camera expose, and its strobe run, and send no frame any more."""
    stage.scan()
    stage.note_exposures()
    stage.fault("camera", drop_frames=ENDLESS)
    stage.expect_parked(limit_s)
    stage.expect_reported("no frame has come")
    stage.call("stop")
    stage.expect_recording()


@fault("daq-underrun", "parked within 0.5 s, recording kept, reported", PARKED_WITHIN_S)
def _daq_underrun(stage: Stage, limit_s: float) -> None:
    """End the waveform by an underrun of the card's memory."""
    stage.scan()
    stage.fault_s = time.perf_counter()
    stage.log.card.break_with(-200621)
    stage.expect_parked(limit_s)
    stage.expect_reported("ran out of samples", "200621")
    stage.finish()


def _card_refuses_while_closing(stage: Stage, limit_s: float, refuse_s: float) -> None:
    """Close the engine while the card refuses every call for `refuse_s`."""
    stage.scan()
    stage.note_exposures()
    stage.status()
    guardian, _ = stage.switch("guardian")
    stage.card_fault(refuse_s=refuse_s)
    stage.close()
    stage.expect_parked(limit_s)
    stage.expect(ends_within(guardian, 5.0), "the guardian's process did not end")
    stage.expect_recording()


for name, refuse_s in (("card-refuses-while-closing", SHORT_S), ("card-refuses-long-while-closing", LONG_S)):
    promise = "parked within 0.5 s after the card accepts again"
    fault(name, promise, refuse_s + PARKED_WITHIN_S)(partial(_card_refuses_while_closing, refuse_s=refuse_s))


@fault("card-refuses-park", "reported as not parked, parked within 0.5 s after the card accepts", LONG_S + 0.5)
def _card_refuses_park(stage: Stage, limit_s: float) -> None:
    """Press Park while the card refuses every call for 3 s."""
    stage.scan()
    stage.card_fault(refuse_s=LONG_S)
    stage.expect_refused(stage.begin("park"), "NOT PARKED")
    stage.expect_parked(limit_s)
    stage.finish()


@fault("clear-task-error", "parked within 0.5 s, watched as before", PARKED_WITHIN_S)
def _clear_task_error(stage: Stage, limit_s: float) -> None:
    """Let ClearTask fail, its task left running, while Park is pressed; then lose the strobe of the next scan."""
    stage.scan()
    stage.card_fault(clear_errors=3)
    stage.call("park")
    stage.expect_parked(limit_s)
    stage.finish()
    first_s = stage.parked_s
    stage.log.card.inject(clear_errors=0)
    stage.call("start")
    stage.wait_for(stage.scans, "scan")
    stage.fault("cut_strobe")
    stage.expect_parked(limit_s)
    stage.expect_reported("strobe")
    if first_s is not None and stage.parked_s is not None:
        stage.parked_s = max(first_s, stage.parked_s)


@fault("park-refused-until-reset", "the card is reset, parked within 0.5 s", PARKED_WITHIN_S)
def _park_refused_until_reset(stage: Stage, limit_s: float) -> None:
    """Let the card refuse every new task until it is reset, which puts its output at 0 V, while Park is pressed."""
    stage.scan()
    stage.fault_s = time.perf_counter()
    stage.log.card.break_with(-50103)
    stage.call("park")
    stage.expect_parked(limit_s)
    stage.finish()


@fault("card-hangs", "parked within 2 s although calls of the driver do not return", 2.0)
def _card_hangs(stage: Stage, limit_s: float) -> None:
    """Let calls of the driver not return until the card is reset, while Park is pressed."""
    stage.scan()
    stage.card_fault(hangs=True)
    stage.begin("park")
    stage.expect_parked(limit_s)
    stage.log.card.inject(hangs=False)
    stage.finish()


@fault("voltage-out-of-range", "refused before the card, the scan goes on", 2.0)
def _voltage_out_of_range(stage: Stage, limit_s: float) -> None:
    """Hold the line at 9 V."""
    stage.scan()
    stage.fault_s = time.perf_counter()
    stage.expect_refused(stage.begin("hold", 9.0), "limit", timeout_s=limit_s)
    outside = [p for p in stage.log.programs if abs(p.resting_v) > 2 or (len(p.samples) and abs(p.samples).max() > 2)]
    stage.expect(not outside, "the card was given a voltage outside the limits")
    stage.expect_undisturbed()
