"""Core pattern of the fibre bundle: its pitch, the positions of the cores, and three filters that suppress it.

The paper applies a 3x3 median where the bundle is well sampled, and no filter where it is not. A Gaussian is linear
and so preserves the sum of the light. Interpolation takes the values at the cores, whose positions are found in a flat
field, and rebuilds the image between them.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, sqrt
from typing import TYPE_CHECKING, Final

import cv2
import numpy as np
from scipy.fft import rfft2
from scipy.ndimage import median_filter
from scipy.sparse import csr_array
from scipy.spatial import Delaunay, cKDTree

from napari_elsplus.errors import MeasurementError
from napari_elsplus.instrument.arguments import Choice

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Filter = Callable[[NDArray[np.float32]], NDArray[np.float32]]

GAUSSIAN_SIGMA_PITCHES: Final = 0.4
"""Sigma of the Gaussian filter, core pitches; measured (`bench cores`): it leaves 2 to 3 % of the core pattern."""
_MIN_PITCH_PX: Final = 2.0
"""Smallest core pitch that is searched for, pixels; derived: the Nyquist limit."""
_MIN_PROMINENCE: Final = 3.0
"""Smallest ratio of the power of the core pattern's ring to its surroundings; chosen: images of noise stay below 2."""
_MIN_CORES: Final = 100
"""Local maxima that are taken for cores; chosen: light without cores has a few."""
_MIN_CONTRAST: Final = 0.1
"""Difference of local maxima and minima over the mean from which they are cores; chosen: above the noise of light that
was smoothed."""
_DARKEST_CORE: Final = 0.1
"""Level of the dimmest core that counts, fraction of the flat field's mean; chosen: dead cores are darker."""
_NEAREST_PITCHES: Final = 0.35
"""Smallest distance of two cores along rows or columns, core pitches; chosen: half of that of touching cores."""
_READING_SIGMA_PITCHES: Final = 0.2
"""Sigma of the Gaussian with which a core is read, core pitches; chosen: half of the filter's, within one core."""


class CoreFilter(Choice):
    """Filter that suppresses the core pattern."""

    NONE = "none"
    MEDIAN = "median"
    """3x3 median, the paper's."""
    GAUSSIAN = "gaussian"
    """Gaussian of 0.4 core pitches."""
    INTERPOLATE = "interpolate"
    """Barycentric interpolation between the cores found in the flat field."""

    def prepared(self, flat: NDArray[np.float32] | None, inside: NDArray[np.bool_]) -> Filter:
        """Return the filter as a function, calibrated for images of one bundle.

        Parameters
        ----------
        flat : numpy.ndarray or None
            (n, n) float32 image of evenly lit cores, on the images' grid; required by `GAUSSIAN` and `INTERPOLATE`.
        inside : numpy.ndarray
            (n, n) bool, the lit disc.

        Returns
        -------
        callable
            (n, n) float32 to (n, n) float32; the argument is not modified.

        Raises
        ------
        MeasurementError
            If the cores are not resolved in the flat field.
        """
        match self:
            case CoreFilter.NONE:
                return lambda image: image
            case CoreFilter.MEDIAN:
                return lambda image: cv2.medianBlur(image, 3)
        if flat is None:
            raise MeasurementError(
                f"the core filter {self.value!r} needs a flat field",
                "calibrate with --bundle or --flat, or filter with 'median'",
            )
        if self is CoreFilter.GAUSSIAN:
            sigma_px = GAUSSIAN_SIGMA_PITCHES * core_pitch_px(flat, inside)
            return lambda image: cv2.GaussianBlur(image, (0, 0), sigma_px)
        return CoreInterpolation.from_flat(flat, inside)


def core_pitch_px(flat: NDArray[np.floating], inside: NDArray[np.bool_]) -> float:
    """Estimate the core pitch from the ring of the core pattern in the power spectrum.

    Parameters
    ----------
    flat : numpy.ndarray
        (n, n) image of evenly lit cores.
    inside : numpy.ndarray
        (n, n) bool, the lit disc.

    Returns
    -------
    float
        Core pitch in pixels. A hexagonal lattice of pitch p has its ring at 2 / (sqrt(3) p) cycles per pixel.

    Raises
    ------
    MeasurementError
        If no ring stands out: the camera does not resolve the cores.
    """
    side = len(flat)
    level = float(flat[inside].mean())
    window = np.hanning(side).astype(np.float32)
    light = np.where(inside, np.subtract(flat, level, dtype=np.float32), 0) * (window[:, None] * window)
    spectrum = np.square(np.abs(rfft2(light)))
    frequency = np.hypot(np.fft.fftfreq(side)[:, None], np.fft.rfftfreq(side))
    ring = np.minimum((frequency * side / 2).astype(int), side)
    power = np.bincount(ring.ravel(), spectrum.ravel()) / np.maximum(np.bincount(ring.ravel()), 1)
    centre = (np.arange(len(power)) + 0.5) * 2 / side
    readable = (centre > 0.06) & (centre < 2 / sqrt(3) / _MIN_PITCH_PX)
    prominence = np.where(readable, power / np.maximum(median_filter(power, max(9, side // 16)), 1e-30), 0)
    peak = int(prominence.argmax())
    if prominence[peak] < _MIN_PROMINENCE:
        raise MeasurementError(
            f"no core pattern found in the flat field (ring {prominence[peak]:.1f} times its surroundings)",
            "the cores are not resolved: use the core filter 'median' or 'none'",
        )
    around = slice(max(peak - 2, 0), peak + 3)
    return float(2 / sqrt(3) / np.average(centre[around], weights=power[around]))


def core_spacing_px(light: NDArray[np.floating], inside: NDArray[np.bool_]) -> float | None:
    """Estimate the mean spacing of the cores from the density of local maxima, also where they lie without order.

    Parameters
    ----------
    light : numpy.ndarray
        (n, n) image of evenly lit cores, above darkness.
    inside : numpy.ndarray
        (n, n) bool, the lit disc.

    Returns
    -------
    float or None
        Pitch in pixels of the hexagonal lattice with as many cores; where the camera does not resolve them 2 to 3.5,
        the spacing of maxima of its noise. None where maxima are few or low.

    Examples
    --------
    >>> row, col = np.mgrid[3:123, 3:123]
    >>> cores = 2 + np.cos(2 * np.pi * row / 6) + np.cos(2 * np.pi * col / 6)  # 36 px each
    >>> round(core_spacing_px(cores, np.ones((120, 120), bool)), 1)
    6.4
    """
    image, around = light.astype(np.float32), np.ones((3, 3))
    peaks, dips = (inside & (image == extreme(image, around)) for extreme in (cv2.dilate, cv2.erode))
    cores, level = np.count_nonzero(peaks & (image > 0)), image[inside].mean()
    if cores < _MIN_CORES or image[peaks].mean() - image[dips].mean() < _MIN_CONTRAST * level:
        return None
    return sqrt(2 / sqrt(3) * np.count_nonzero(inside) / cores)


def find_cores(flat: NDArray[np.floating], inside: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Detect the centres of the cores in a flat field.

    Parameters
    ----------
    flat : numpy.ndarray
        (n, n) image of evenly lit cores.
    inside : numpy.ndarray
        (n, n) bool, the lit disc.

    Returns
    -------
    numpy.ndarray
        (cores, 2) float64, row and column in pixels.

    Raises
    ------
    MeasurementError
        If the camera does not resolve the cores.
    """
    from scipy.signal import resample  # 1 s to import, so only where cores are found

    pitch_px = core_pitch_px(flat, inside)
    zoom = ceil(8 / pitch_px)
    fine = np.where(inside, flat, 0)
    for axis, size in enumerate(flat.shape):
        fine = resample(fine, zoom * size, axis=axis)
    darkest = _DARKEST_CORE * float(flat[inside].mean())
    centres: NDArray[np.float64] = _peaks(fine, int(_NEAREST_PITCHES * zoom * pitch_px), darkest) / zoom
    return centres


def _peaks(image: NDArray[np.floating], reach: int, threshold: float) -> NDArray[np.intp]:
    """Return the pixels (peaks, 2) that are above a threshold and the brightest within a reach, brightest first.

    As `skimage.feature.peak_local_max`, in a hundredth of its time; nothing is found within the reach of the edge.
    """
    nearby = cv2.dilate(image, np.ones((2 * reach + 1, 2 * reach + 1), np.uint8))
    inner = (slice(reach, -reach),) * 2
    found = np.argwhere((image == nearby)[inner] & (image > threshold)[inner]) + reach
    found = found[np.argsort(-image[tuple(found.T)], kind="stable")]
    kept = np.ones(len(found), bool)
    for first, second in sorted(cKDTree(found).query_pairs(reach - 0.5, p=np.inf)):  # pixels of the same top
        kept[second] &= not kept[first]
    return found[kept]


@dataclass(frozen=True)
class CoreInterpolation:
    """Linear interpolation in the triangles between cores, of the values read at the cores.

    Each core is read with a narrow Gaussian, divided by what it reads in the flat field and scaled to the
    flat field's local mean, so that brightness and vignetting are preserved and each core's transmission is removed.

    Attributes
    ----------
    reading : scipy.sparse.csr_array
        (cores, pixels) float32: bilinear weights of the pixels around each core.
    between : scipy.sparse.csr_array
        (pixels, cores) float32: barycentric coordinates of each pixel times the cores' gain, the local mean over the
        reading in the flat field; none where no cores are around.
    sigma_px : float
        Sigma of the Gaussian with which cores are read, pixels.
    """

    reading: csr_array
    between: csr_array
    sigma_px: float

    @classmethod
    def from_flat(cls, flat: NDArray[np.float32], inside: NDArray[np.bool_]) -> CoreInterpolation:
        """Return the interpolation for a bundle: detect the cores, and tabulate the triangles.

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
        cores = find_cores(flat, inside)
        reading, sigma_px, wide = _bilinear(cores, len(flat)), _READING_SIGMA_PITCHES * pitch_px, 2 * pitch_px
        mean = cv2.GaussianBlur(np.where(inside, flat, 0).astype(np.float32), (0, 0), wide)
        mean /= np.maximum(cv2.GaussianBlur(inside.astype(np.float32), (0, 0), wide), 1e-3)
        read = reading @ cv2.GaussianBlur(flat, (0, 0), sigma_px).ravel()
        gain = reading @ mean.ravel() / np.maximum(read, _DARKEST_CORE * float(flat[inside].mean()))
        triangles = Delaunay(cores)
        pixels = np.argwhere(inside).astype(float)
        simplex = triangles.find_simplex(pixels)  # which tries every triangle for a pixel that is in none
        within = simplex >= 0
        transform, corners = triangles.transform[simplex[within]], triangles.simplices[simplex[within]]
        two = np.einsum("ijk,ik->ij", transform[:, :2], pixels[within] - transform[:, 2])
        weights = np.column_stack([two, 1 - two.sum(axis=1)]) * gain[corners]
        pixel = np.flatnonzero(inside)[within].astype(np.int32).repeat(3)
        between = csr_array((weights.ravel(), (pixel, corners.ravel())), (inside.size, len(cores)), np.float32)
        return cls(reading, between, sigma_px)

    def __call__(self, image: NDArray[np.float32]) -> NDArray[np.float32]:
        """Interpolate an image (n, n) float32 between the cores; zero outside of them."""
        values = self.reading @ cv2.GaussianBlur(image, (0, 0), self.sigma_px).ravel()
        return np.asarray((self.between @ values).reshape(image.shape), np.float32)


def _bilinear(places: NDArray[np.float64], side: int) -> csr_array:
    """Return the weights (places, pixels) float32 of the pixels around places (n, 2) inside of a square image."""
    corner = np.minimum(places.astype(np.int32), side - 2)
    (down, across), (row, col) = (places - corner).T, corner.T
    pixels = (row * side + col)[:, None] + np.array([0, 1, side, side + 1], np.int32)
    weights = np.stack([(1 - down) * (1 - across), (1 - down) * across, down * (1 - across), down * across], axis=1)
    of_place = np.arange(len(places), dtype=np.int32).repeat(4)
    return csr_array((weights.ravel(), (of_place, pixels.ravel())), (len(places), side * side), np.float32)
