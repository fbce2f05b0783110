"""Layers of a mosaic's maps, hidden at first: number of frames at each place, and their mean registration score."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from napari.layers import Image

from napari_elsplus._view import change_layer
from napari_elsplus.processing.mosaicing.coverage import CELL_PX
from napari_elsplus.widgets.mosaic.own_layers import COVERAGE, QUALITY
from napari_elsplus.widgets.mosaic.track_layers import SCORES

if TYPE_CHECKING:
    from napari_elsplus.processing.mosaicing.coverage import Coverage
    from napari_elsplus.widgets.mosaic.own_layers import OwnLayers


def maps_visible(own: OwnLayers) -> bool:
    """Return True if any of the maps is visible: only then are frames counted.

    Parameters
    ----------
    own : OwnLayers
        Layers of the mosaic.
    """
    present = own.present
    return any(kind in present and present[kind].visible for kind in (COVERAGE, QUALITY))


def draw_maps(own: OwnLayers, maps: Coverage, place: tuple[float, float]) -> None:
    """Create or update the layers of the maps.

    Parameters
    ----------
    own : OwnLayers
        Layers of the mosaic.
    maps : Coverage
        Counts and scores.
    place : tuple of float
        World position (row, col) of the mosaic's (0, 0).
    """
    highest = max(1.0, float(maps.frames.max()))
    frames = np.where(maps.frames > 0, maps.frames, np.float32(np.nan))  # transparent where there are none
    cell = CELL_PX * own.step
    inset = (cell - own.step) / 2
    corner = (place[0] + maps.part.top * own.step + inset, place[1] + maps.part.left * own.step + inset)
    for kind, data, limits in ((COVERAGE, frames, (0.0, highest)), (QUALITY, maps.quality, SCORES)):
        layer, made = own.obtain(
            kind,
            partial(
                Image, data, name=f"mosaic {kind}", colormap="viridis", contrast_limits=limits, opacity=0.6,
                visible=False,
            ),
        )  # fmt: skip
        if layer is None:
            continue
        if made:
            layer.colorbar.visible = True
        if not made and layer.data.shape == data.shape:
            layer.data[:] = data
            layer.refresh(extent=False, highlight=False)
        elif not made:
            layer.data = data
        if kind == COVERAGE:
            change_layer(layer, contrast_limits=limits)
        change_layer(layer, scale=(cell, cell), translate=corner)
