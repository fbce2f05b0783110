"""Montage of the mosaics of all segments in one image."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from napari_elsplus.processing.mosaicing.tiles import Canvas


GAP_PX: Final = 16
"""Empty rows between two segments; chosen: seen at any scale at which a mosaic is displayed."""


def montage(mosaics: Sequence[Canvas]) -> NDArray[np.float32]:
    """Stack the mosaics of all segments vertically in one image, the largest first.

    Parameters
    ----------
    mosaics : sequence of Canvas
        At least one into which a frame was inserted.

    Returns
    -------
    numpy.ndarray
        (rows, cols) float32; 0 where nothing was inserted.

    Raises
    ------
    InputError
        If the list is empty.
    """
    images = sorted((mosaic.read()[0] for mosaic in mosaics), key=lambda image: -image.size)
    if not images:
        raise InputError("no frame could be placed", "check the frames: is the probe on the tissue?")
    height = sum(len(image) + GAP_PX for image in images) - GAP_PX
    canvas = np.zeros((height, max(image.shape[1] for image in images)), np.float32)
    top = 0
    for image in images:
        canvas[top : top + len(image), : image.shape[1]] = image
        top += len(image) + GAP_PX
    return canvas
