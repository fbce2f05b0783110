"""Canvas of samples: weighted sums of the cores' values on cells finer than the cores."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from napari_elsplus.processing.mosaicing.cores.least_squares import Samples, local_means
from napari_elsplus.processing.mosaicing.tiles import TILE_PX, Rectangle, TiledCanvas, tile_rectangle

if TYPE_CHECKING:
    from numpy.typing import NDArray


class SampleCanvas(TiledCanvas):
    """Canvas on which point samples are summed in the cells nearest to them; reading it returns local means.

    One thread adds; any thread may read.

    Parameters
    ----------
    smoothing : float
        Standard deviation of the Gaussian over which :meth:`read` averages samples, cells.

    Examples
    --------
    >>> canvas = SampleCanvas(1.0)
    >>> canvas.add(np.array([[1.2, 3.9], [0.8, 4.1]]), np.float32([2, 4]), np.float32([3, 1]))
    >>> samples = canvas.samples(Rectangle(0, 4, 2, 5))
    >>> samples.means.ravel().tolist(), samples.weights.ravel().tolist()
    ([0.0, 2.5], [0.0, 4.0])
    """

    def __init__(self, smoothing: float) -> None:
        super().__init__(blended=True)
        self._smoothing = smoothing

    def samples(self, part: Rectangle) -> Samples:
        """Return the samples of a part of the canvas."""
        return Samples(*super().read(part))

    def read(self, part: Rectangle | None = None) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return local means of the samples in a part of the canvas, by default all, and their local density.

        Parameters
        ----------
        part : Rectangle, optional
            The whole extent by default.

        Returns
        -------
        image, density : numpy.ndarray
            (rows, cols) float32; 0 where there are no samples near.
        """
        part = part or self.extent or Rectangle(0, 0, 0, 0)
        if 0 in part.shape:
            return super().read(part)
        wide = part.grown(int(4 * self._smoothing))
        image, density = local_means(self.samples(wide), self._smoothing)
        here = part.slices(wide)
        return image[here], density[here]

    def add(self, places: NDArray[np.float64], values: NDArray[np.float32], weights: NDArray[np.float32]) -> None:
        """Add samples.

        Parameters
        ----------
        places : numpy.ndarray
            (m, 2) float64 row and column on the canvas, cells.
        values, weights : numpy.ndarray
            (m,) float32; samples that are not finite are left out.
        """
        used = np.isfinite(values) & (weights > 0)
        cells = np.rint(places[used]).astype(np.int64)
        if not len(cells):
            return
        (top, left), (bottom, right) = cells.min(axis=0).tolist(), (cells.max(axis=0) + 1).tolist()
        touched = Rectangle(top, left, bottom, right)
        heavy = weights[used]
        light = heavy * values[used]
        with self._lock:
            for key in touched.tiles():
                within = cells - tile_rectangle(*key)[:2]
                on_tile = ((within >= 0) & (within < TILE_PX)).all(axis=1)
                pixel = np.ravel_multi_index(tuple(within[on_tile].T), (TILE_PX, TILE_PX))
                tile = self._store.tile(*key)
                np.add.at(tile.value.reshape(-1), pixel, light[on_tile])
                np.add.at(tile.weight.reshape(-1), pixel, heavy[on_tile])
            self._mark_drawn(touched)


class ImageCanvas(TiledCanvas):
    """Canvas of finished pixels, written part by part."""

    def write(self, part: Rectangle, image: NDArray[np.float32], weight: NDArray[np.float32]) -> None:
        """Write a part.

        Parameters
        ----------
        part : Rectangle
            Pixels of the canvas.
        image, weight : numpy.ndarray
            (rows, cols) float32 grey levels and weights, 0 where there is nothing.
        """
        with self._lock:
            for key, here, there in part.pieces():
                tile = self._store.tile(*key)
                tile.value[there], tile.weight[there] = image[here], weight[here]
            self._mark_drawn(part)
