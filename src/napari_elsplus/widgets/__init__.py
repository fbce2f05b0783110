"""Thin forms over public functions, for napari's docks; nobody imports them."""
