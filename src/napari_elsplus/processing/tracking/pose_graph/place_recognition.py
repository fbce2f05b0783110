"""Recognition of places by thumbnails: which earlier nodes show what a node shows, over all shifts.

A thumbnail is a frame freed of its motion and its rotation, high-passed, in cells of eight grid pixels. Its correlation
with another over all shifts takes one inverse Fourier transform of 48 x 48, some 16 us, so that a node is compared with
all of thousands; only candidates are registered. The odds of a shift with correlation r over n independent values are
-n/2 ln(1 - r^2) nats, less the logarithms of the numbers of shifts and of thumbnails.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import cv2
import numpy as np
from scipy import fft

from napari_elsplus.processing.tracking.front_end.grid import FIELD
from napari_elsplus.processing.tracking.registration.masked_correlation import high_passed
from napari_elsplus.processing.tracking.registration.motion_models import turned_by, unsheared, upright

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.front_end.grid import Grid
    from napari_elsplus.processing.tracking.motion.rolling_shutter import Velocity
    from napari_elsplus.processing.tracking.registration.pair_registration import PreparedFrame

CELL_PX: Final = 8
"""Grid pixels per cell; chosen: about 26 cells across the field, one inverse transform of 48 x 48 a pair."""
MIN_OVERLAP: Final = 0.25
"""Smallest overlap that is searched, fraction of the field; chosen: with less, right shifts do not stand out."""
_REACH: Final = 0.65
"""Largest shift that is searched, diameters of the field; derived: the overlap of discs is a quarter there."""
_BATCH: Final = 64
"""Thumbnails that are compared at once; chosen: their spectra fit into a cache of 1 MB."""
_LEVEL: Final = 2
"""Level of the pyramid from which thumbnails are averaged: quarter resolution."""
_HIGH_PASS_CELLS: Final = 3.0
"""Standard deviation of the high-pass; chosen: brightness that varies over half of the field is removed."""
_CELLS_PER_VALUE: Final = 2.0
"""Cells that share one independent value; chosen, so that of unrelated nuclei one in ten thousand has positive odds."""
_MIN_ENERGY: Final = 1e-3
"""Part of a thumbnail's energy below which an overlap counts as empty; chosen, against division by zero."""
_MAX_CORRELATION: Final = 0.999
"""Largest correlation that is counted; chosen, against the logarithm of zero."""


class Thumbnail(NamedTuple):
    """A prepared thumbnail.

    Parameters
    ----------
    spectrum : numpy.ndarray
        (size, size // 2 + 1) complex64 Fourier transform.
    as_earlier, as_later : numpy.ndarray
        (shifts, shifts) float32: one over the norm of its part in the overlap, by the shift of the later thumbnail.
    """

    spectrum: NDArray[np.complex64]
    as_earlier: NDArray[np.float32]
    as_later: NDArray[np.float32]


class Candidate(NamedTuple):
    """A node that probably shows the same place.

    Parameters
    ----------
    node : int
        Its number.
    odds : float
        Log odds of the best shift against unrelated frames at all shifts, nats.
    displacement : complex
        Of the other node from this one, upright, row + i col, grid pixels; known to about one cell.
    """

    node: int
    odds: float
    displacement: complex


class PlaceRecognition:
    """Makes thumbnails and compares them over all shifts.

    Parameters
    ----------
    grid : Grid
        Tracking grid.
    """

    def __init__(self, grid: Grid) -> None:
        self._grid = grid
        self._cells = grid.side // CELL_PX
        y, x = (CELL_PX * (np.arange(self._cells) + 0.5) - 0.5 - c for c in grid.centre)
        self._mask = (np.hypot(y[:, None], x) < 0.5 * FIELD * grid.diameter - CELL_PX / 2).astype(np.float32)
        reach = int(_REACH * FIELD * grid.diameter / CELL_PX)
        self._size = fft.next_fast_len(self._cells + reach, real=True)
        self._shifts = np.arange(-reach, reach + 1)
        self._mask_spectrum = self._transform(self._mask)
        overlap = np.maximum(self._at_shifts(np.conj(self._mask_spectrum) * self._mask_spectrum), 1.0)
        searched = overlap > MIN_OVERLAP * self._mask.sum()
        self._values = np.where(searched, overlap / _CELLS_PER_VALUE, 0).astype(np.float32)
        self._upright = np.zeros((grid.side >> _LEVEL,) * 2, np.float32)

    def thumbnail(self, view: PreparedFrame, velocity: Velocity, angle: float) -> Thumbnail:
        """Return the thumbnail of a frame.

        Parameters
        ----------
        view : PreparedFrame
            The frame.
        velocity : Velocity
            Of the probe while it was read.
        angle : float
            Of the probe, radians.
        """
        matrix = turned_by(angle) @ unsheared(velocity, self._grid.shutter.line_periods_per_frame)
        px = 2**_LEVEL
        row, col = ((c - (px - 1) / 2) / px for c in self._grid.centre)
        image = upright(view.levels[_LEVEL], self._upright, (row, col), matrix)
        used = self._cells * (CELL_PX >> _LEVEL)
        cells = cv2.resize(image[:used, :used], (self._cells, self._cells), interpolation=cv2.INTER_AREA)
        cells = high_passed(cells, self._mask, _HIGH_PASS_CELLS)
        square, mask = self._transform(cells * cells), self._mask_spectrum
        energy = self._at_shifts(np.stack([np.conj(square) * mask, np.conj(mask) * square]))
        floor = _MIN_ENERGY * max(float((cells * cells).sum()), _MIN_ENERGY)
        return Thumbnail(self._transform(cells), *(1 / np.sqrt(np.maximum(energy, floor))))

    def candidates(self, thumbnail: Thumbnail, others: Mapping[int, Thumbnail], limit: int) -> list[Candidate]:
        """Return the nodes that probably show the place of a thumbnail, the most probable first.

        Parameters
        ----------
        thumbnail : Thumbnail
            Of the later node.
        others : mapping of int to Thumbnail
            Those of the nodes to compare it with.
        limit : int
            Largest number of candidates.
        """
        nodes = list(others)
        found: list[tuple[float, int]] = []
        for begin in range(0, len(nodes), _BATCH):
            some = [others[node] for node in nodes[begin : begin + _BATCH]]
            alike = self._at_shifts(np.conj([other.spectrum for other in some]) * thumbnail.spectrum)
            alike *= np.array([other.as_earlier for other in some]) * thumbnail.as_later
            np.clip(alike, 0.0, _MAX_CORRELATION, out=alike)
            likelihood = (-0.5 * self._values * np.log1p(-alike * alike)).reshape(len(some), -1)
            found += zip(likelihood.max(axis=1).tolist(), likelihood.argmax(axis=1).tolist(), strict=True)
        tried = np.log(np.count_nonzero(self._values)) + np.log(max(len(nodes), 1))
        best = []
        for k in sorted(range(len(nodes)), key=lambda k: -found[k][0])[:limit]:
            down, across = (self._shifts[v].item() for v in divmod(found[k][1], len(self._shifts)))
            best.append(Candidate(nodes[k], found[k][0] - tried, -CELL_PX * complex(down, across)))
        return [candidate for candidate in best if candidate.odds > 0]

    def _transform(self, cells: NDArray[np.float32]) -> NDArray[np.complex64]:
        spectrum: NDArray[np.complex64] = fft.rfft2(cells, (self._size, self._size))
        return spectrum

    def _at_shifts(self, spectra: NDArray[np.complex64]) -> NDArray[np.float32]:
        """Return correlations at the shifts that are searched, (..., shifts, shifts)."""
        whole = fft.irfft2(spectra, (self._size, self._size))
        return np.ascontiguousarray(whole[..., self._shifts[:, None], self._shifts], np.float32)
