"""Slit and offset for a depth, from the calibrated line."""
