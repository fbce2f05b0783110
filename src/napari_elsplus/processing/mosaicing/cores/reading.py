"""Values of a bundle's cores in an image, fitted as spots, and relative to those in a flat field.

A camera that samples a core by 2.4 pixels sees the light of its neighbours in the same pixels. The image is therefore
fitted by one Gaussian spot at each core: by least squares, so that a core's value is free of its neighbours' light and
has the least noise. The flat field is fitted in the same way; the ratio of both is free of the core's transmission.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.sparse import csr_array, diags_array
from scipy.sparse.linalg import cg
from scipy.spatial import cKDTree

from napari_elsplus.errors import MeasurementError
from napari_elsplus.processing.images.cores import core_pitch_px, find_cores

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

SPOT_PITCHES: Final = 0.26
"""Standard deviation of a core's spot on the camera, and of the mode through which it collects, core pitches; measured
on simulated bundles of 0.30: with their cores located to 0.06 pitches, wider spots overshoot at edges. The spots in
photographs of real bundles are wider."""
_SPOT_REACH: Final = 1.1
"""Distance from a core up to which its spot is fitted, core pitches; chosen: a spot has fallen to 2 % there or less."""
_ITERATIONS: Final = 6
"""Steps of conjugate gradients of the fit; derived: neighbours share at most a tenth of their light, so that each step
gains a digit."""
_SOLVED: Final = 1e-30
"""Grey levels left over of the fit at which no further step is possible; chosen: below every image's."""
_NEIGHBOURS: Final = 37
"""Cores over which the flat field is averaged; derived: three rings about a core."""
_DEAD: Final = 0.2
"""Value of a core relative to its neighbours' mean below which it is left out; chosen: dead cores are darker."""


@dataclass(frozen=True)
class BundleCores:
    """The cores of a bundle on the grid of its images, and how they are read.

    Attributes
    ----------
    positions : numpy.ndarray
        (m, 2) float64 row and column on the images' grid, pixels.
    gain : numpy.ndarray
        (m,) float32 factor that frees a core's value of its transmission: local mean over value in the flat field.
    pitch_px : float
        Core pitch, pixels.
    """

    positions: Floats
    gain: NDArray[np.float32]
    pitch_px: float
    _spots: csr_array
    """(pixels, m) the spots."""
    _normal: csr_array
    """(m, m) their products."""
    _chosen: NDArray[np.intp]

    @classmethod
    def from_flat(cls, flat: NDArray[np.float32], inside: NDArray[np.bool_]) -> BundleCores:
        """Detect the cores in a flat field and estimate their spots and gains.

        Parameters
        ----------
        flat : numpy.ndarray
            (n, n) float32 image of evenly lit cores.
        inside : numpy.ndarray
            (n, n) bool, the lit disc.

        Raises
        ------
        MeasurementError
            If the camera does not resolve the cores.
        """
        pitch_px = core_pitch_px(flat, inside)
        found = find_cores(flat, inside)
        spots = _spots(found, SPOT_PITCHES * pitch_px, _SPOT_REACH * pitch_px, flat.shape)
        normal = csr_array(spots.T @ spots)
        values = _fitted(spots, normal, flat)
        _, near = cKDTree(found).query(found, k=min(_NEIGHBOURS, len(found)))
        local = values[near].mean(axis=1)
        alive = values > _DEAD * np.maximum(local, 1e-6)
        if not alive.any():
            raise MeasurementError("no core is lit in the flat field", "is the probe lit from the far end?")
        gain = (local[alive] / values[alive]).astype(np.float32)
        return cls(found[alive], gain, pitch_px, spots, normal, np.flatnonzero(alive))

    def __len__(self) -> int:
        return len(self.positions)

    def read(self, image: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the value of each core in an image, free of its transmission.

        Parameters
        ----------
        image : numpy.ndarray
            (n, n) float32; NaN where nothing was seen.

        Returns
        -------
        numpy.ndarray
            (m,) float32, NaN for cores beside unseen pixels.
        """
        unseen = np.isnan(image)
        if not unseen.any():
            return _fitted(self._spots, self._normal, image)[self._chosen] * self.gain
        values = _fitted(self._spots, self._normal, np.where(unseen, np.float32(0), image))
        values[np.asarray(self._spots.T @ unseen.ravel().astype(np.float32)) > 0] = np.nan
        return values[self._chosen] * self.gain

    @property
    def weights(self) -> NDArray[np.float32]:
        """Inverse variances of the values relative to their mean, (m,) float32: those of shot noise at equal light."""
        return np.asarray(1 / self.gain, np.float32)


def _fitted(spots: csr_array, normal: csr_array, image: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the amplitudes (m,) of the spots that fit an image best, by conjugate gradients."""
    right = np.asarray(spots.T @ image.ravel(), np.float32)
    inverse = 1 / normal.diagonal()
    values, _ = cg(normal, right, right * inverse, rtol=0, atol=_SOLVED, maxiter=_ITERATIONS, M=diags_array(inverse))
    return np.asarray(values, np.float32)


def _spots(centres: Floats, sigma_px: float, reach_px: float, shape: tuple[int, ...]) -> csr_array:
    """Return the spots (pixels, m) at centres (m, 2), each with a peak of 1."""
    rows, cols = shape
    half = int(np.ceil(reach_px))
    around = np.arange(-half, half + 1)
    nearest = np.rint(centres).astype(np.int64)
    r = nearest[:, 0, None, None] + around[:, None]
    c = nearest[:, 1, None, None] + around
    away = (r - centres[:, 0, None, None]) ** 2 + (c - centres[:, 1, None, None]) ** 2
    used = (away <= reach_px**2) & (r >= 0) & (r < rows) & (c >= 0) & (c < cols)
    pixel, core = (r * cols + c)[used], np.broadcast_to(np.arange(len(centres))[:, None, None], used.shape)[used]
    values = np.exp(-0.5 * away[used] / sigma_px**2).astype(np.float32)
    return csr_array((values, (pixel, core)), shape=(rows * cols, len(centres)))
