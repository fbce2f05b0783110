"""The bundle as the camera sees it: its cores' places in both views, and the pixels that they light."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from napari_elsplus.simulation.rendering.sensor import Spots, spread_spots

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.simulation.model.bundle import Bundle, Cores
    from napari_elsplus.simulation.model.instrument import Instrument, RightView


class BundleView(NamedTuple):
    """One image of the bundle: its gain, its centre's row, its cores' places (px), the pixels that they light."""

    gain: float
    centre_row: float
    rows_px: NDArray[np.float64]
    cols_px: NDArray[np.float64]
    spots: Spots


class BundleViews(NamedTuple):
    """The bundle's cores, and its left (confocal) and right (residual) view."""

    cores: Cores
    left: BundleView
    right: BundleView


def views(instrument: Instrument) -> BundleViews:
    """Lay the bundle out on the camera; the same instrument's layout is kept, as it takes some tenths of a second."""
    return _views(
        instrument.bundle,
        instrument.right,
        instrument.left_centre,
        instrument.right_centre,
        instrument.frame_shape,
        instrument.optics.um_per_px,
    )


@lru_cache(maxsize=4)
def _views(
    bundle: Bundle,
    right: RightView,
    left_centre: tuple[float, float],
    right_centre: tuple[float, float],
    frame_shape: tuple[int, int],
    um_per_px: float,
) -> BundleViews:
    cores = bundle.cores()
    cores_px = np.stack([cores.rows_um, cores.cols_um]) / um_per_px

    def view(gain: float, centre: tuple[float, float], places: NDArray[np.float64]) -> BundleView:
        rows, cols = places + np.array(centre)[:, None]
        return BundleView(gain, centre[0], rows, cols, spread_spots(rows, cols, frame_shape, bundle, um_per_px))

    return BundleViews(cores, view(1.0, left_centre, cores_px), view(right.gain, right_centre, right.matrix @ cores_px))
