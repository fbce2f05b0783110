"""Compilation of napari's shape layers before the first one is needed.

napari compiles their triangulation when the first shape is made, which takes seconds once on every installation.
"""

from __future__ import annotations

import numpy as np
from napari.layers import Shapes


def prepare_shapes() -> None:
    """Compile the drawing of lines, rectangles and ellipses; call it in a thread."""
    corners = np.array([(0.0, 0.0), (0.0, 1.0), (1.0, 1.0), (1.0, 0.0)])
    Shapes([corners[:2], corners, corners], shape_type=["line", "rectangle", "ellipse"])
