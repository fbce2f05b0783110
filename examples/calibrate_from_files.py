"""Calibrate from files: line, sweep with its voltages, transmission and background, as a real rig records them.

Takes a folder with these files (``python calibrate_from_files.py FOLDER``); simulates them without.
"""

import sys
from pathlib import Path

import napari_elsplus as elsplus

folder = Path(sys.argv[1]) if len(sys.argv) == 2 else Path("rig")
if len(sys.argv) < 2:
    elsplus.simulate_calibration(seed=1).save(folder, force=True)

found = elsplus.calibrate(
    line=folder / "line.tif",
    sweep=folder / "sweep.tif",
    volts=folder / "sweep_volts.csv",
    bundle=folder / "transmission.tif",
    background=folder / "background.tif",
    bundle_um=620,
    line_period_s=7.648e-6,
    line_periods_per_frame=544.8,
)
elsplus.save_calibration("rig.json", found.calibration, force=True)
print(f"slit offset {found.offset.rows:.3f} +- {found.offset.uncertainty_rows:.3f} rows")
print(f"galvo {found.galvo.volts_per_row:.6f} V per row, R^2 {found.galvo.r_squared:.6f}")
print(f"alignment error {100 * found.calibration.quality.alignment_error:.2f} %")
