"""Cancellation of the two views in transmission: the alignment error, unfiltered and after each core filter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.errors import MeasurementError
from napari_elsplus.processing.analysis.image_quality import PAPER_ALIGNMENT_PERCENT, alignment_error
from napari_elsplus.processing.calibration.bundle.gain import darkness
from napari_elsplus.processing.images.cores import GAUSSIAN_SIGMA_PITCHES, CoreFilter
from napari_elsplus.processing.images.sectioning import Sectioner, disc

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import Calibration

FILTER_NAMES: Final = {
    CoreFilter.GAUSSIAN: f"Gaussian filter ({GAUSSIAN_SIGMA_PITCHES:g} core pitches)",
    CoreFilter.MEDIAN: "3x3 median filter",
}
"""Filters after which the alignment error is measured, the first that can be applied being that of the calibration."""
PAPER_TEXT: Final = "Thrapp 2021, USAF target in transmission: {} % unfiltered, {} % after its core filter".format(
    *PAPER_ALIGNMENT_PERCENT
)
"""The paper's alignment errors; it does not name the filter, and no 3x3 median reduces its error to an eighth."""


@dataclass(frozen=True, slots=True)
class AlignmentErrors:
    """Mean absolute difference of the two views over the mean of the confocal one, in the 90 % disc.

    Attributes
    ----------
    before : float
        Fraction, unfiltered.
    filtered : mapping
        Fraction after each core filter, that of the calibration first.
    """

    before: float
    filtered: Mapping[CoreFilter, float]

    @property
    def cores(self) -> CoreFilter:
        """The calibration's core filter: the Gaussian where a flat field resolves the cores, else the median."""
        return next(iter(self.filtered))

    @property
    def after(self) -> float:
        """Fraction after the calibration's core filter."""
        return self.filtered[self.cores]

    @property
    def text(self) -> str:
        """The errors in per cent, each with its filter."""
        parts = [f"{100 * error:.2f} % after the {FILTER_NAMES[kind]}" for kind, error in self.filtered.items()]
        return ", ".join([f"{100 * self.before:.2f} % unfiltered", *parts])


def measure_alignment_errors(image: NDArray[np.floating], calibration: Calibration) -> AlignmentErrors:
    """Measure the alignment error of a raw frame in transmission, above the darkness around its bundle images.

    Parameters
    ----------
    image : numpy.ndarray
        (rows, cols), raw: the bundle lit from its far end, the laser off.
    calibration : Calibration
        Contains the bundle section; with a flat field the Gaussian filter is applied, too.

    Raises
    ------
    CalibrationError
        If the calibration has no bundle or does not fit the frame.
    """
    bundle = calibration.measured_bundle
    frame = np.asarray(image, np.float32)
    above_dark = calibration.model_copy(update={"background": darkness(frame, bundle.discs)})
    sectioner = Sectioner(above_dark, frame.shape)
    views = sectioner.ls(frame), sectioner.residual(frame)
    inside = disc(sectioner.side, bundle.diameter_px)
    filtered = {}
    for kind in FILTER_NAMES:
        try:
            smooth = kind.prepared(calibration.flat, inside)
        except MeasurementError:
            continue  # no flat field, or its cores are not resolved
        filtered[kind] = alignment_error(smooth(views[0]), smooth(views[1]), bundle.diameter_px)
    return AlignmentErrors(alignment_error(*views, bundle.diameter_px), filtered)
