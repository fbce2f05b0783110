"""Measurement of the slit offset in frame after frame, while the tilt mirror is being turned."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

from napari_elsplus.errors import MeasurementError
from napari_elsplus.processing.calibration.slit_offset import measure_offset

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from napari_elsplus.processing.calibration.measurements import BundlePair
    from napari_elsplus.processing.calibration.slit_offset import SlitOffset

SEARCH_INTERVAL_FRAMES: Final = 60
"""Frames between searches of the whole view, as the followed line may be a reflection; chosen: half a second."""


class OffsetFollower:
    """Measures the slit offset in one frame after the other, each line searched near its last position.

    Core and halo of the line, which do not depend on the tilt mirror, are fitted whenever the whole view is searched.

    Parameters
    ----------
    background : numpy.ndarray, optional
        Mean frame of the dark tube.
    pair : BundlePair, optional
        The bundle images.
    """

    def __init__(self, background: NDArray[np.float32] | None = None, pair: BundlePair | None = None) -> None:
        self._background, self._pair = background, pair
        self._last: SlitOffset | None = None
        self._followed = 0

    def measure(self, frame: NDArray[np.generic]) -> SlitOffset:
        """Measure the offset in a raw frame (rows, cols).

        Raises
        ------
        MeasurementError
            If there is no line in one of the views.
        """
        last = self._last if self._followed < SEARCH_INTERVAL_FRAMES else None
        self._followed = 0 if last is None else self._followed + 1
        try:
            found = measure_offset([frame], self._background, self._pair, near=last)
        except MeasurementError:
            self._last = None
            raise
        self._last = found if last is None else replace(found, parts=last.parts)
        return self._last
