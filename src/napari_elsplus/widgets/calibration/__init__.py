"""The Calibration panel: steps that are measured, reviewed, accepted or discarded."""
