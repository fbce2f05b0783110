"""Track a probe with a registration function of one's own: scikit-image's masked phase correlation.

``python examples/extending/registration_method.py`` tracks a simulated recording and prints the error of the positions.
"""

from __future__ import annotations

import numpy as np
from skimage.registration import phase_cross_correlation

from napari_elsplus.processing.tracking.pairwise_tracking import PairwiseShift
from napari_elsplus.processing.tracking.registry import register_pairwise_method
from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.simulation.rendering.renderer import Renderer
from napari_elsplus.simulation.specimen.scenes import scene
from napari_elsplus.simulation.specimen.trajectories import trajectory
from napari_elsplus.simulation.truth import true_calibration
from napari_elsplus.workflows.tracking import Pipeline

NAME = "phase-correlation"
MIN_CORRELATION = 0.6
"""Correlation of the overlap below which the two images do not determine the shift; chosen."""


def phase_correlation(fixed, moving, expected):
    """Register two images by masked normalised cross-correlation (Padfield 2012, 10.1109/TIP.2011.2181402)."""
    lit = fixed != 0, moving != 0
    if not (lit[0].any() and lit[1].any()):
        return None
    shift, *_ = phase_cross_correlation(
        fixed, moving, reference_mask=lit[0], moving_mask=lit[1], overlap_ratio=0.4, normalization=None
    )
    score = overlap_correlation(fixed, moving, np.round(shift).astype(int))
    if score < MIN_CORRELATION:
        return None
    return PairwiseShift((float(shift[0]), float(shift[1])), np.eye(2) / 12, score)  # whole pixels: variance 1/12


def overlap_correlation(fixed, moving, shift):
    """Return the correlation of the pixels that both images show."""
    row, col = shift
    rows, cols = fixed.shape
    here = fixed[max(row, 0) : rows + min(row, 0), max(col, 0) : cols + min(col, 0)]
    there = moving[max(-row, 0) : rows + min(-row, 0), max(-col, 0) : cols + min(-col, 0)]
    both = (here != 0) & (there != 0)
    return float(np.corrcoef(here[both], there[both])[0, 1]) if both.sum() > 1 else 0.0


def register() -> None:
    """Add the method; the function to name in the entry point group ``napari_elsplus.tracking_methods``."""
    register_pairwise_method(NAME, phase_correlation, "scikit-image's masked phase correlation, whole pixels")


def main(frames: int = 24, speed_um_s: float = 1500.0) -> float:
    """Track a simulated recording and return the largest error of a position, camera pixels."""
    instrument = Instrument.of("120hz")
    path = trajectory("hand", speed_um_s=speed_um_s)
    renderer = Renderer(instrument, scene("fibres"), path, seed=1)
    calibration = true_calibration(instrument)
    pipeline = Pipeline(calibration, instrument.frame_shape, method=NAME)
    for index in range(frames):
        pipeline.add(renderer.render(index), index)
    optics = instrument.optics
    times_s = (
        np.arange(frames) + instrument.confocal_centre[0] / optics.line_periods_per_frame
    ) * optics.frame_period_s
    true_px = path.positions_um(times_s) / optics.um_per_px
    found_px = np.array([(row.row_px, row.col_px) for row in pipeline.rows])
    return float(np.abs(found_px - (true_px - true_px[0])).max())


if __name__ == "__main__":
    register()
    print(f"largest error of a position: {main():.2f} camera pixels")
