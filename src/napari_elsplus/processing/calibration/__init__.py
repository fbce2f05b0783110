"""From calibration frames to slit offset, galvo map, scan lag and bundle pair, with their uncertainties."""
