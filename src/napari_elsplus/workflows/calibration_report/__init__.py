"""Plots of the calibration's steps, and the calibration report."""
