"""The Calibration panel: step after step, each measured, looked at, accepted or discarded."""
