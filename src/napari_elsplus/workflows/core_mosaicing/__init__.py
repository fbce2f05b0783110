"""Mosaics finer than the images that are tracked: in pixels of the camera, and core by core."""
