"""Run a rig without napari: calibrate, stream, record one second, and report what was lost.

Takes the name of a rig and its calibration (``python run_the_simulated_rig.py RIG CALIBRATION``); without them the
simulated rig, which is calibrated first.
"""

import sys
import time

import napari_elsplus as elsplus

rig = sys.argv[1] if len(sys.argv) == 3 else "simulated"
calibration = elsplus.load_calibration(sys.argv[2]) if len(sys.argv) == 3 else None

with elsplus.open_engine(rig, calibration=calibration, preset="240hz") as engine:
    engine.start()
    engine.record(elsplus.RecordingPlan("live.ome.tif", seconds=1, force=True))
    while engine.status().recording.running:
        time.sleep(0.1)
    status = engine.status()

print(f"{status.recorded} frames at {status.camera_hz:.0f} Hz, lost: {dict(status.dropped)}")
with elsplus.open_recording("live.ome.tif") as recording:
    print(f"live.ome.tif: {recording.shape[0]} frames of {recording.shape[1]} x {recording.shape[2]} px")
