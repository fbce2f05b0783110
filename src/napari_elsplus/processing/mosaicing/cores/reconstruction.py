"""Reconstruction of a canvas of samples, part by part."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import cv2
import numpy as np

from napari_elsplus.processing.mosaicing.cores.canvas import ImageCanvas, SampleCanvas
from napari_elsplus.processing.mosaicing.cores.least_squares import choose_smoothness, reconstruct
from napari_elsplus.processing.mosaicing.tiles import Canvas, Rectangle

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

PART: Final = 1024
"""Side of the parts that are reconstructed at once, cells; chosen: 40 MB of arrays."""
_MARGIN: Final = 32
"""Cells around a part that are reconstructed with it; chosen: eight core pitches, where its edge is forgotten."""
_TRIAL: Final = 256
"""Side of the part on which the smoothness is chosen, cells; chosen: four thousand cores."""
_TRIALS: Final = 3
"""Places tried for that part along each axis."""
_MIN_DENSITY: Final = 0.05
"""Density of samples, relative to its mean, from which there is an image; chosen."""


def canvas_smoothness(canvas: SampleCanvas, aperture: float) -> float:
    """Return the smoothness for a canvas of samples, chosen on a part with many of them.

    Parameters
    ----------
    canvas, aperture
        As of :func:`reconstruct_canvas`.
    """
    assert canvas.extent is not None
    trial = max(_trials(canvas.extent), key=lambda part: np.count_nonzero(canvas.samples(part).weights))
    return choose_smoothness(canvas.samples(trial), aperture)


def reconstruct_canvas(canvas: SampleCanvas, aperture: float, smoothness: float) -> ImageCanvas:
    """Return the image that explains the samples of a canvas; weights are the local density of samples.

    Parameters
    ----------
    canvas : SampleCanvas
        The samples, at least one.
    aperture : float
        Standard deviation of the Gaussian through which a sample sees the image, cells.
    smoothness : float
        Weight of the image's squared gradient: :func:`canvas_smoothness`.
    """
    extent = canvas.extent
    assert extent is not None
    densities = [canvas.read(part)[1] for part in _trials(extent)]
    least = _MIN_DENSITY * float(np.mean([density[density > 0].mean() for density in densities if density.any()]))
    image_canvas = ImageCanvas()
    for part in _parts(extent):
        wide = part.grown(_MARGIN)
        image, density = (
            reconstruct(canvas.samples(wide), aperture, smoothness)[part.slices(wide)],
            canvas.read(part)[1],
        )
        shown = density > least
        image_canvas.write(part, image * shown, density * shown)
    return image_canvas


def seen_through(canvas: Canvas, part: Rectangle, aperture: float) -> NDArray[np.float32]:
    """Return a part of an image as cores see it.

    Parameters
    ----------
    canvas : Canvas
        The image.
    part : Rectangle
        The part.
    aperture : float
        Standard deviation of a core's mode, pixels.

    Returns
    -------
    numpy.ndarray
        (rows, cols) float32, NaN where there is no image.
    """
    image, weight = canvas.read(part)
    seen: NDArray[np.float32] = cv2.GaussianBlur(image, (0, 0), aperture)
    seen[weight <= 0] = np.nan
    return seen


def _trials(extent: Rectangle) -> Iterator[Rectangle]:
    """Yield parts on which the smoothness may be chosen, spread over the extent."""
    rows, cols = extent.shape
    for row in np.linspace(0, max(rows - _TRIAL, 0), _TRIALS).astype(int).tolist():
        for col in np.linspace(0, max(cols - _TRIAL, 0), _TRIALS).astype(int).tolist():
            top, left = extent.top + row, extent.left + col
            yield Rectangle(top, left, top + min(_TRIAL, rows), left + min(_TRIAL, cols))


def _parts(extent: Rectangle) -> Iterator[Rectangle]:
    for top in range(extent.top, extent.bottom, PART):
        for left in range(extent.left, extent.right, PART):
            yield Rectangle(top, left, min(top + PART, extent.bottom), min(left + PART, extent.right))
