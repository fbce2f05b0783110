"""Recommend slit and offset for haze at a depth, from frames of the standing line and of the bundle lit evenly.

Takes a calibration that contains the line's core and halo (``python recommend_an_offset.py CALIBRATION``); simulates
its frames without.
"""

import sys
from pathlib import Path

import napari_elsplus as elsplus

if len(sys.argv) == 2:
    calibration = elsplus.load_calibration(sys.argv[1])
else:
    folder = Path("rig")
    elsplus.simulate_calibration(seed=1).save(folder, force=True)
    files = {"line": folder / "line.tif", "bundle": folder / "transmission.tif"}
    calibration = elsplus.calibrate(**files, bundle_um=620).calibration

for keep in (0.8, 0.9, 0.95):
    found = elsplus.recommend(calibration, depth_um=60, keep=keep)
    expected, sigmas = found.expected, found.sigmas
    print(
        f"to keep {100 * keep:.0f} %: slit {found.slit_rows:g} rows, offset {found.offset_rows:.1f} rows; haze from "
        f"60 um is left to {100 * expected.haze:.1f} +- {100 * sigmas['haze']:.1f} % of what is in focus"
    )
