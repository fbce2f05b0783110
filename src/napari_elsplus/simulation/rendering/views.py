"""Views of the bundle on the sensor: positions of the cores, and the pixels that they light."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from napari_elsplus.simulation.rendering.sensor import Spots, spread_spots

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.simulation.model.bundle import Bundle, Cores
    from napari_elsplus.simulation.model.instrument import Instrument, ResidualView


class BundleView(NamedTuple):
    """One view of the bundle: gain, row of its centre, positions of the cores (px), pixels that they light."""

    gain: float
    centre_row: float
    rows_px: NDArray[np.float64]
    cols_px: NDArray[np.float64]
    spots: Spots


class BundleViews(NamedTuple):
    """The bundle's cores, and its confocal (left) and residual (right) view."""

    cores: Cores
    left: BundleView
    right: BundleView


def views(instrument: Instrument) -> BundleViews:
    """Return the views of an instrument's bundle; cached, as computing them takes some tenths of a second."""
    return _views(
        instrument.bundle,
        instrument.residual_view,
        instrument.confocal_centre,
        instrument.residual_centre,
        instrument.frame_shape,
        instrument.optics.um_per_px,
    )


@lru_cache(maxsize=4)
def _views(
    bundle: Bundle,
    residual_view: ResidualView,
    confocal_centre: tuple[float, float],
    residual_centre: tuple[float, float],
    frame_shape: tuple[int, int],
    um_per_px: float,
) -> BundleViews:
    cores = bundle.cores()
    cores_px = np.stack([cores.rows_um, cores.cols_um]) / um_per_px

    def view(gain: float, centre: tuple[float, float], places: NDArray[np.float64]) -> BundleView:
        rows, cols = places + np.array(centre)[:, None]
        return BundleView(gain, centre[0], rows, cols, spread_spots(rows, cols, frame_shape, bundle, um_per_px))

    return BundleViews(
        cores,
        view(1.0, confocal_centre, cores_px),
        view(residual_view.gain, residual_centre, residual_view.matrix @ cores_px),
    )
