"""Priors of the motion between two frames, for tests of their registration."""

from __future__ import annotations

from math import isfinite

from napari_elsplus.processing.tracking.motion.motion_prior import MotionPrior
from napari_elsplus.processing.tracking.motion.rolling_shutter import RollingShutter, Warp

STRETCH = 0.02


def about(shutter: RollingShutter, warp: Warp, stretch: float = STRETCH, shift_px: float = 8.0) -> MotionPrior:
    """A prior about a warp, with such standard deviations of stretch and shear, and of the shift."""
    before, after = shutter.velocities(warp)
    rows = shutter.line_periods_per_frame
    sigma = stretch * rows / 2**0.5 if isfinite(rows) else 1.0
    return MotionPrior.between((before, after), shutter.displacement(warp, after), (sigma, sigma), shift_px, shutter)
