"""Views of the bundle on the sensor: positions of the cores, and the pixels that they light."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from napari_elsplus.instrument.optics import SENSOR_SHAPE
from napari_elsplus.simulation.rendering.sensor import Spots, spread_spots

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.simulation.model.bundle import Bundle, Cores
    from napari_elsplus.simulation.model.imperfections import Imperfections
    from napari_elsplus.simulation.model.instrument import Instrument, ResidualView


_RIGHT_GAIN: Final = 0x6A1
"""Keeps the cores' gains apart from other uses of the bundle's seed; chosen."""


class BundleView(NamedTuple):
    """One view of the bundle: gain, row of its centre, positions of the cores (px), pixels that they light.

    ``gain`` holds for fluorescence, of all cores or (cores,) of each; that for a lamp is greater by ``lamp_factor``.
    """

    gain: float | NDArray[np.float64]
    lamp_factor: float
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
        instrument.preset.sensor_origin,
        instrument.imperfections.of_views,
    )


@lru_cache(maxsize=4)
def _views(
    bundle: Bundle,
    residual_view: ResidualView,
    confocal_centre: tuple[float, float],
    residual_centre: tuple[float, float],
    frame_shape: tuple[int, int],
    um_per_px: float,
    sensor_origin: tuple[int, int],
    imperfections: Imperfections,
) -> BundleViews:
    cores = bundle.cores()
    cores_px = np.stack([cores.rows_um, cores.cols_um]) / um_per_px
    radius_px = bundle.radius_um / um_per_px
    sensor_centre = (np.array(SENSOR_SHAPE) - 1) / 2 - sensor_origin

    def view(
        gain: float | NDArray[np.float64],
        lamp_factor: float,
        centre: tuple[float, float],
        places: NDArray[np.float64],
        distortion_percent: float,
    ) -> BundleView:
        on_sensor = _distorted(places, radius_px, distortion_percent) + np.array(centre)[:, None]
        from_middle = on_sensor - sensor_centre[:, None]
        if imperfections.lens_distortion_percent:
            lens_px = SENSOR_SHAPE[1] / 2
            on_sensor = _distorted(from_middle, lens_px, imperfections.lens_distortion_percent) + sensor_centre[:, None]
        rows, cols = on_sensor
        spots = spread_spots(rows, cols, frame_shape, bundle, um_per_px)
        return BundleView(gain, lamp_factor, centre[0], rows, cols, spots)

    right_gain = residual_view.gain * _gain_pattern(cores, bundle, imperfections)
    return BundleViews(
        cores,
        view(1.0, 1.0, confocal_centre, cores_px, imperfections.left_distortion_percent),
        view(
            right_gain,
            1 + imperfections.lamp_gain_percent / 100,
            residual_centre,
            residual_view.matrix @ cores_px,
            imperfections.right_distortion_percent,
        ),
    )


def _distorted(places: NDArray[np.float64], radius_px: float, percent: float) -> NDArray[np.float64]:
    """Move points (2, n) about an origin radially, by a share of their distance that grows with its square."""
    if not percent:
        return places
    return np.asarray(places * (1 + percent / 100 * (places**2).sum(0) / radius_px**2))


def _gain_pattern(cores: Cores, bundle: Bundle, imperfections: Imperfections) -> float | NDArray[np.float64]:
    """Return the right view's gain relative to its mean, of all cores or of each."""
    per_core, vignette = imperfections.right_core_gain_percent / 100, imperfections.right_vignette_percent / 100
    if not (per_core or vignette):
        return 1.0
    drawn = np.random.default_rng((_RIGHT_GAIN, bundle.seed)).normal(1, per_core, len(cores.rows_um))
    bowl = 1 + vignette * (1 - 2 * (cores.rows_um**2 + cores.cols_um**2) / bundle.radius_um**2)
    gain = np.clip(drawn, 0.1, None) * bowl
    return np.asarray(gain / gain.mean())
