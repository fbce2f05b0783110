"""Layers of the probe's track: lines coloured by score, and marks of segment starts, predicted and lost frames."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from napari.layers import Points, Vectors

from napari_elsplus._view import change_layer
from napari_elsplus.viewing.mosaic.track import BEGINS, LOST, PREDICTED
from napari_elsplus.widgets.mosaic.own_layers import MARKS, TRACK

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.viewing.mosaic.track import TrackGeometry
    from napari_elsplus.widgets.mosaic.own_layers import OwnLayers

SCORES: Final = (0.5, 1.0)
"""Correlations at the ends of the colormap; chosen, lower ones are rejected by the acceptance test."""
_COLOURS: Final = {PREDICTED: "#e69f00", LOST: "#d55e00", BEGINS: "#56b4e9"}
_SYMBOLS: Final = {PREDICTED: "ring", LOST: "x", BEGINS: "disc"}
_LINE_SHARE: Final = 0.004
_MARK_SHARE: Final = 0.015
"""Width of lines and size of marks, fractions of the mosaic's longer side, visible at any size; chosen."""
_POSITION_TOLERANCE_PX: Final = 0.5
"""Marks are redrawn if one has moved further, pixels of the mosaic; chosen, below visibility."""


def draw_track(own: OwnLayers, drawn: TrackGeometry, place: tuple[float, float], span_px: int) -> None:
    """Draw a track over its mosaic.

    Parameters
    ----------
    own : OwnLayers
        Layers of the mosaic.
    drawn : TrackGeometry
        Lines and marks, in pixels of the mosaic.
    place : tuple of float
        World position (row, col) of the mosaic's (0, 0).
    span_px : int
        Longer side of the mosaic, pixels.
    """
    if len(drawn.lines) or TRACK in own.present:
        _draw_lines(own, drawn, place, span_px)
    if len(drawn.marks) or MARKS in own.present:
        _draw_marks(own, drawn, place, span_px)


def _draw_lines(own: OwnLayers, drawn: TrackGeometry, place: tuple[float, float], span_px: int) -> None:
    features = {"score": np.nan_to_num(drawn.score, nan=1.0), "segment": drawn.segment + 1}
    layer, made = own.obtain(
        TRACK,
        lambda: Vectors(
            drawn.lines, features=features, edge_color="score", edge_colormap="viridis",
            edge_contrast_limits=SCORES, edge_width=2, vector_style="line", name="mosaic track",
        ),
    )  # fmt: skip
    if layer is None:
        return
    if not made:
        layer.data = drawn.lines
        layer.features = features
        layer.refresh_colors()
    change_layer(layer, translate=place, edge_width=max(2.0, _LINE_SHARE * span_px))


def _draw_marks(own: OwnLayers, drawn: TrackGeometry, place: tuple[float, float], span_px: int) -> None:
    colours = [_COLOURS[kind] for kind in drawn.kinds]
    symbols = [_SYMBOLS[kind] for kind in drawn.kinds]
    features = {"kind": drawn.kinds, "label": drawn.labels}
    new = own.is_new(MARKS)
    layer, made = own.obtain(
        MARKS,
        lambda: Points(
            drawn.marks, features=features, symbol=symbols, face_color=colours, border_color=colours,
            text={"string": "{label} ", "color": _COLOURS[BEGINS], "anchor": "lower_right", "size": 11},
            name="mosaic track marks",
        ),
    )  # fmt: skip
    if layer is None:
        return
    if new or not _alike(layer.data, drawn.marks):
        if not made:
            layer.data = drawn.marks
        if not made and len(drawn.marks):
            layer.features = features
            layer.symbol, layer.face_color, layer.border_color = symbols, colours, colours
        layer.size = max(8.0, _MARK_SHARE * span_px)
    change_layer(layer, translate=place)


def _alike(one: NDArray[np.float64], other: NDArray[np.float64]) -> bool:
    return one.shape == other.shape and np.allclose(one, other, rtol=0, atol=_POSITION_TOLERANCE_PX)
