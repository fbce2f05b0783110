"""Measure the optical sectioning: drop-off distances of LS and ELS+ from a scan of depths.

Takes a scan with ``NAME.depths.csv`` and its calibration beside it (``python measure_the_sectioning.py SCAN``);
simulates one without.
"""

import sys

import napari_elsplus as elsplus

if len(sys.argv) == 2:
    response = elsplus.measure_axial_response(elsplus.open_recording(sys.argv[1]))
else:
    depth_um = [*range(0, 120, 4), *range(120, 700, 20)]
    scan = elsplus.simulate_axial_scan(offset_um=29, slit_um=2.9, depth_um=depth_um)
    response = elsplus.measure_axial_response(scan, scan.calibration, scan.depth_um)

for name, half, tenth in (("LS", response.ls_3db, response.ls_10db), ("ELS+", response.els_3db, response.els_10db)):
    print(f"{name}: 3 dB at {half.um:.1f} um, 10 dB at {tenth.um:.1f} um")
print(f"signal kept in contact: {100 * response.signal_kept:.0f} %")
