"""An independent, slow renderer: the line set onto the bundle row by row, its light followed there and back on a grid.

Nothing is separated and nothing looked up: light enters on the disc of cores, part of it spreads across the line inside
the bundle, leaves where there are cores, diffuses to each plane, excites it, diffuses back, and is read by the cores of
one row. It shares the axial model's parameters with the fast renderer, and no code of it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import gaussian_filter, gaussian_filter1d, map_coordinates
from scipy.special import ndtr

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.simulation.model.axial_response import LineModel
    from napari_elsplus.simulation.model.bundle import Cores
    from napari_elsplus.simulation.model.instrument import Instrument
    from napari_elsplus.simulation.specimen.scenes import Scene

STEP_UM = 0.8
MARGIN_UM = 45.0


def core_values(instrument: Instrument, scene: Scene, cores: Cores, offset_um: float) -> NDArray[np.float64]:
    """What each core of a view receives, on the scale on which light_dn is an in-focus plane of brightness 1."""
    radius = instrument.bundle.radius_um
    alone, on_the_way_back = 1 - instrument.line.halo_share, instrument.imperfections.halo_in_collection_percent / 100
    line = replace(instrument.line, halo_share=1 - alone ** (1 - on_the_way_back))
    cross_talk = 1 - alone**on_the_way_back
    inner = np.sqrt(line.halo_um**2 - line.core_um**2) / STEP_UM
    axis = np.arange(-radius - MARGIN_UM, radius + MARGIN_UM, STEP_UM)
    fine = axis[:, None] + STEP_UM * ((np.arange(4) + 0.5) / 4 - 0.5)
    inside = np.hypot(fine.ravel()[:, None], fine.ravel()) <= radius
    disc = inside.reshape(len(axis), 4, len(axis), 4).mean((1, 3))
    mode = instrument.bundle.core_sigma * instrument.bundle.core_pitch_um / STEP_UM
    planes = [
        (
            plane.depth_um * line.spread / np.sqrt(2) / STEP_UM,
            plane.brightness * gaussian_filter(plane.texture.sample(axis, axis).astype(float), mode),
        )
        for plane in scene.planes
    ]
    values = np.zeros(len(cores.rows_um))
    for row_um in np.unique(cores.rows_um):
        here = np.flatnonzero(cores.rows_um == row_um)
        places = (np.stack([cores.rows_um[here], cores.cols_um[here]]) - axis[0]) / STEP_UM
        face, face_unmasked = _face(instrument, line, axis, disc, row_um + offset_um)
        for sigma, brightness in planes:
            if sigma == 0:
                seen, returning = face_unmasked * brightness, face * brightness
            else:
                seen = returning = gaussian_filter(
                    gaussian_filter(face, sigma, mode="constant") * brightness, sigma, mode="constant"
                )
            if cross_talk:
                seen = (1 - cross_talk) * seen + cross_talk * gaussian_filter(returning * disc, inner, mode="constant")
            values[here] += map_coordinates(seen, places, order=3)
    reference = _face(instrument, instrument.line, np.arange(-400.0, 400.0, STEP_UM), 1.0, 0.0)[1].max()
    return values / reference * instrument.light_dn * cores.transmission


def _face(
    instrument: Instrument,
    line: LineModel,
    axis: NDArray[np.float64],
    disc: NDArray[np.float64] | float,
    line_um: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Light that leaves the distal face for a line at a row, exposed through the moving slit; masked and not."""
    half = instrument.slit_um / 2
    away = axis - line_um
    profile = (ndtr((away + half) / line.core_um) - ndtr((away - half) / line.core_um)) / (2 * half)
    enters = profile[:, None] * disc * np.ones(len(axis))
    inner = np.sqrt(line.halo_um**2 - line.core_um**2) / STEP_UM
    halo = gaussian_filter1d(enters, inner, axis=0, mode="constant", truncate=6)
    # in contact, a core sees its own light: what the laser puts into it, disc or not, and the halo that reaches it
    in_contact = (1 - line.halo_share) * profile[:, None] + line.halo_share * halo
    return ((1 - line.halo_share) * enters + line.halo_share * halo) * disc, in_contact
