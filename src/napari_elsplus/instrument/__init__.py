"""What the instrument is, in numbers: optics, presets, and the record of its calibration."""
