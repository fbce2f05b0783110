"""Axial response, resolution, image quality, and the statistics that they rest on."""
