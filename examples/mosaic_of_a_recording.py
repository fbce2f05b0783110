"""Track the probe through a recording and insert its ELS+ images into a mosaic.

Takes a recording and its calibration (``python mosaic_of_a_recording.py RAW CALIBRATION``); simulates both without.
"""

import sys

import napari_elsplus as elsplus

if len(sys.argv) == 3:
    recording = elsplus.open_recording(sys.argv[1])
    calibration = elsplus.load_calibration(sys.argv[2])
else:
    recording = elsplus.simulate_recording(path="spiral", speed_um_s=4000, frames=40, seed=1)
    calibration = recording.calibration

result = elsplus.mosaic(recording, calibration, "els")
result.save("mosaic.ome.tif", "track.csv", force=True)
tracked = sum(point.state == "tracked" for point in result.track)
rows, cols = result.image.shape
print(f"{tracked} of {len(result.track)} frames tracked, mosaic of {rows} x {cols} px")
