"""Calibration steps on a running engine."""
