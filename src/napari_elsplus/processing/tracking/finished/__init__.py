"""Tracking of finished images of any microscope."""
