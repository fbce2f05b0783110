"""The rectangle of pixels that the frame contains, whichever edge cuts the bundle's disc."""

from __future__ import annotations

import numpy as np
import pytest

from napari_elsplus.processing.tracking.front_end.grid import rectangle_within

SIDE, CENTRE, RADIUS = 100, 49.5, 45.0


def cut(*edges: str) -> np.ndarray:
    """Return True where a pixel of the disc is seen, or none is expected; 8 pixels are cut off at each edge."""
    rows, cols = np.mgrid[:SIDE, :SIDE]
    inside = np.hypot(rows - CENTRE, cols - CENTRE) < RADIUS
    off = {"top": rows < 12, "bottom": rows >= 88, "left": cols < 12, "right": cols >= 88}
    return ~(inside & np.any([off[edge] for edge in edges], axis=0))


@pytest.mark.parametrize(
    ("edges", "rectangle"),
    [
        (("top",), (12, 100, 0, 100)),
        (("bottom",), (0, 88, 0, 100)),
        (("left",), (0, 100, 12, 100)),
        (("right",), (0, 100, 0, 88)),
        (("top", "left"), (12, 100, 12, 100)),
        (("top", "bottom", "right"), (12, 88, 0, 88)),
    ],
)
def test_only_what_an_edge_cuts_is_left_out(edges: tuple[str, ...], rectangle: tuple[int, int, int, int]) -> None:
    """Of a disc that was cut at its side, the rows from the top down to its middle were left out instead."""
    assert rectangle_within(cut(*edges)) == rectangle


def test_nothing_is_left_of_an_unseen_disc() -> None:
    assert rectangle_within(np.zeros((5, 6), bool)) == (0, 0, 0, 0)
