"""The layers of a mosaic's maps: how often each place was seen, and how well its frames fit; hidden at first."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from napari.layers import Image

from napari_elsplus.processing.mosaicing.coverage import CELL_PX
from napari_elsplus.widgets.mosaic.own_layers import COVERAGE, QUALITY, move
from napari_elsplus.widgets.mosaic.track_layers import SCORES

if TYPE_CHECKING:
    from napari_elsplus.processing.mosaicing.coverage import Coverage
    from napari_elsplus.widgets.mosaic.own_layers import OwnLayers


def looked_at(own: OwnLayers) -> bool:
    """Whether any of the maps is shown: only then are frames counted."""
    present = own.present
    return any(kind in present and present[kind].visible for kind in (COVERAGE, QUALITY))


def draw_maps(own: OwnLayers, maps: Coverage, place: tuple[float, float]) -> None:
    """Make the maps, or fill them.

    Parameters
    ----------
    own : OwnLayers
        Where they are drawn.
    maps : Coverage
        What they show.
    place : tuple of float
        Row and column of the world where the (0, 0) of the mosaic lies over which they lie.
    """
    frames, quality = maps.frames, maps.quality
    cell = CELL_PX * own.step
    inset = (cell - own.step) / 2
    corner = (place[0] + maps.part.top * own.step + inset, place[1] + maps.part.left * own.step + inset)
    most = max(1.0, float(frames.max()))
    for kind, data, limits in ((COVERAGE, frames, (0.0, most)), (QUALITY, quality, SCORES)):
        layer, made = own.take(
            kind,
            partial(
                Image, data, name=f"mosaic {kind}", colormap="viridis", contrast_limits=limits, opacity=0.6,
                visible=False,
            ),
        )  # fmt: skip
        if layer is None:
            continue
        if not made and layer.data.shape == data.shape:
            layer.data[:] = data
            layer.refresh(extent=False, highlight=False)
        elif not made:
            layer.data = data
        if kind == COVERAGE and layer.contrast_limits != list(limits):
            layer.contrast_limits = limits
        if tuple(layer.scale) != (cell, cell):
            layer.scale = cell, cell
        move(layer, corner)
