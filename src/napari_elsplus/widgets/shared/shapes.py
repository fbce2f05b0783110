"""napari's shapes, made ready before they are needed.

napari compiles what draws its shapes when the first one is made, which takes seconds once on every installation.
"""

from __future__ import annotations

import numpy as np
from napari.layers import Shapes


def prepare_shapes() -> None:
    """Make one shape of each kind that the panels use, shown nowhere; to be called beside the window."""
    corners = np.array([(0.0, 0.0), (0.0, 1.0), (1.0, 1.0), (1.0, 0.0)])
    Shapes([corners[:2], corners, corners], shape_type=["line", "rectangle", "ellipse"])
