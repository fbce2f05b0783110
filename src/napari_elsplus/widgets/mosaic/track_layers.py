"""The layers of a probe's track: lines coloured by their score, and marks where it begins, is guessed or is lost."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from napari.layers import Points, Vectors

from napari_elsplus.viewing.mosaic.track import BEGINS, LOST, PREDICTED
from napari_elsplus.widgets.mosaic.own_layers import MARKS, TRACK, move

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.viewing.mosaic.track import Drawing
    from napari_elsplus.widgets.mosaic.own_layers import OwnLayers

SCORES: Final = (0.5, 1.0)
"""Correlations at the ends of the track's colours."""
_COLOURS: Final = {PREDICTED: "#e69f00", LOST: "#d55e00", BEGINS: "#56b4e9"}
_SYMBOLS: Final = {PREDICTED: "ring", LOST: "x", BEGINS: "disc"}
_LINE_SHARE: Final = 0.004
_MARK_SHARE: Final = 0.015
"""Of the mosaic's longer side, so that they are seen however large it is."""
_UNSEEN_PX: Final = 0.5
"""Marks that move by no more than that are left where they are."""


def draw_track(own: OwnLayers, drawn: Drawing, place: tuple[float, float], span_px: int) -> None:
    """Draw a track over its mosaic.

    Parameters
    ----------
    own : OwnLayers
        Where it is drawn.
    drawn : Drawing
        In pixels of the mosaic.
    place : tuple of float
        Row and column of the world where the mosaic's (0, 0) lies.
    span_px : int
        Pixels of the mosaic's longer side.
    """
    if len(drawn.lines) or TRACK in own.present:
        _draw_lines(own, drawn, place, span_px)
    if len(drawn.marks) or MARKS in own.present:
        _draw_marks(own, drawn, place, span_px)


def _draw_lines(own: OwnLayers, drawn: Drawing, place: tuple[float, float], span_px: int) -> None:
    features = {"score": np.nan_to_num(drawn.score, nan=1.0), "segment": drawn.segment + 1}
    layer, made = own.take(
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
    move(layer, place)
    width = max(2.0, _LINE_SHARE * span_px)
    if layer.edge_width != width:
        layer.edge_width = width


def _draw_marks(own: OwnLayers, drawn: Drawing, place: tuple[float, float], span_px: int) -> None:
    colours = [_COLOURS[kind] for kind in drawn.kinds]
    symbols = [_SYMBOLS[kind] for kind in drawn.kinds]
    features = {"kind": drawn.kinds, "label": drawn.labels}
    fresh = own.fresh(MARKS)
    layer, made = own.take(
        MARKS,
        lambda: Points(
            drawn.marks, features=features, symbol=symbols, face_color=colours, border_color=colours,
            text={"string": "{label} ", "color": _COLOURS[BEGINS], "anchor": "lower_right", "size": 11},
            name="mosaic track marks",
        ),
    )  # fmt: skip
    if layer is None:
        return
    if fresh or not _alike(layer.data, drawn.marks):
        if not made:
            layer.data = drawn.marks
        if not made and len(drawn.marks):
            layer.features = features
            layer.symbol, layer.face_color, layer.border_color = symbols, colours, colours
        layer.size = max(8.0, _MARK_SHARE * span_px)
    move(layer, place)


def _alike(one: NDArray[np.float64], other: NDArray[np.float64]) -> bool:
    return one.shape == other.shape and np.allclose(one, other, rtol=0, atol=_UNSEEN_PX)
