"""Section a recording: LS, residual and ELS+ images, and the three methods side by side.

Takes a recording and its calibration (``python section_a_recording.py RAW CALIBRATION``); simulates both without.
"""

import sys
from pathlib import Path

import napari_elsplus as elsplus

if len(sys.argv) == 3:
    recording = elsplus.open_recording(sys.argv[1])
    calibration = elsplus.load_calibration(sys.argv[2])
else:
    elsplus.simulate_recording(path="spiral", frames=12, seed=1).save("moving.ome.tif", force=True)
    recording = elsplus.open_recording("moving.ome.tif")
    calibration = recording.calibration  # the one that lies beside the recording

for mode in ("ls", "residual", "els"):
    images = elsplus.section(recording, calibration, mode)
    images.save(f"{mode}.ome.tif", force=True)
    print(f"{mode}: {len(images)} images of {images.side} x {images.side} px, mean {images[0].mean():.1f} grey levels")

comparison = elsplus.compare(recording, calibration, frame=0)
comparison.save(Path("comparison.png"), force=True)
recording.close()
