"""The layers of a mosaic's maps: how often each place was seen, and how well its frames fit; hidden at first."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from napari.layers import Image

from napari_elsplus.processing.mosaicing.coverage import CELL_PX, coverage_maps
from napari_elsplus.viewing.track import placed
from napari_elsplus.widgets.own_layers import COVERAGE, QUALITY
from napari_elsplus.widgets.track_layers import SCORES

if TYPE_CHECKING:
    from napari_elsplus.viewing.growing import GrowingImage
    from napari_elsplus.viewing.mosaics import Mosaics
    from napari_elsplus.widgets.own_layers import OwnLayers


def draw_maps(own: OwnLayers, mosaics: Mosaics, lead: GrowingImage, place: tuple[float, float]) -> None:
    """Make the maps, or fill those that are looked at: they cost more than the track.

    Parameters
    ----------
    own : OwnLayers
        Where they are drawn.
    mosaics : Mosaics
        With the track.
    lead : GrowingImage
        The mosaic over which they lie.
    place : tuple of float
        Row and column of the world where that mosaic's (0, 0) lies.
    """
    present = own.present
    if not any(own.fresh(kind) or (kind in present and present[kind].visible) for kind in (COVERAGE, QUALITY)):
        return
    scale = mosaics.scale
    places, scores = placed(mosaics.rows, lead.sheet.place, scale.camera_px_per_pixel)
    maps = coverage_maps(places, scores, scale.radius_px, lead.frame)
    cell = CELL_PX * own.step
    inset = (cell - own.step) / 2
    corner = (place[0] + lead.frame.top * own.step + inset, place[1] + lead.frame.left * own.step + inset)
    most = max(1.0, float(maps[0].max()))
    for kind, data, limits in ((COVERAGE, maps[0], (0.0, most)), (QUALITY, maps[1], SCORES)):
        layer, made = own.take(
            kind,
            partial(
                Image, data, name=f"mosaic {kind}", colormap="viridis", contrast_limits=limits, opacity=0.6,
                visible=False,
            ),
        )  # fmt: skip
        if layer is None:
            continue
        if not made:
            layer.data = data
            if kind == COVERAGE:
                layer.contrast_limits = limits
        layer.scale, layer.translate = (cell, cell), corner
