"""Description of the instrument: optics, presets, and the record of its calibration."""
