"""The calibration's steps on a running engine."""
