"""Enhanced line-scan (ELS+) fibre-bundle endomicroscopy in napari.

One camera frame holds two images of the bundle: the left with the rolling-shutter slit on the laser line (confocal),
the right with the slit a few rows off (residual). Confocal minus residual is ELS+ (Thrapp and Hughes).

Importing the package imports nothing heavy; each room is imported by its name.
"""

__version__ = "0.1.0"
