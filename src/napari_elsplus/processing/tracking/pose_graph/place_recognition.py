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
from napari_elsplus.processing.tracking.motion.rolling_shutter import Displacement
from napari_elsplus.processing.tracking.registration.motion_models import turned_by, unsheared, upright

if TYPE_CHECKING:
    from collections.abc import Container, Sequence

    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.front_end.grid import Grid
    from napari_elsplus.processing.tracking.motion.pose import Pose
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
    """A frame that probably shows the same place.

    Parameters
    ----------
    frame : int
        Its number.
    odds : float
        Log odds of the best shift against unrelated frames at all shifts, nats.
    displacement : Displacement
        Of the other frame from this one, upright, grid pixels; known to about one cell.
    """

    frame: int
    odds: float
    displacement: Displacement


class PlaceIndex:
    """Thumbnails by the numbers of their frames; used by one thread.

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
        self._values = np.where(overlap > MIN_OVERLAP * self._mask.sum(), overlap / _CELLS_PER_VALUE, 0).astype(
            np.float32
        )
        self._weight = np.maximum(cv2.GaussianBlur(self._mask, (0, 0), _HIGH_PASS_CELLS), 1e-3)
        self._upright = np.zeros((grid.side >> _LEVEL,) * 2, np.float32)
        self._rows: dict[int, int] = {}
        self._spectra = np.zeros((0, self._size, self._size // 2 + 1), np.complex64)
        self._norms = np.zeros((0, len(self._shifts), len(self._shifts)), np.float32)

    def thumbnail(self, view: PreparedFrame, pose: Pose) -> Thumbnail:
        """Return the thumbnail of a frame.

        Parameters
        ----------
        view : PreparedFrame
            The frame.
        pose : Pose
            Its velocity and angle.
        """
        matrix = turned_by(pose.angle) @ unsheared(pose.velocity, self._grid.shutter.line_periods_per_frame)
        px = 2**_LEVEL
        row, col = ((c - (px - 1) / 2) / px for c in self._grid.centre)
        image = upright(view.levels[_LEVEL], self._upright, (row, col), matrix)
        used = self._cells * (CELL_PX >> _LEVEL)
        cells = cv2.resize(image[:used, :used], (self._cells, self._cells), interpolation=cv2.INTER_AREA)
        smooth = cv2.GaussianBlur(cells * self._mask, (0, 0), _HIGH_PASS_CELLS) / self._weight
        cells = (cells - smooth) * self._mask
        square, mask = self._transform(cells * cells), self._mask_spectrum
        energy = self._at_shifts(np.stack([np.conj(square) * mask, np.conj(mask) * square]))
        floor = _MIN_ENERGY * max(float((cells * cells).sum()), _MIN_ENERGY)
        return Thumbnail(self._transform(cells), *(1 / np.sqrt(np.maximum(energy, floor))))

    def add(self, frame: int, thumbnail: Thumbnail) -> None:
        """Add the thumbnail of a frame."""
        count = len(self._rows)
        if count == len(self._spectra):
            more = max(_BATCH, count)
            self._spectra = np.concatenate([self._spectra, np.zeros((more, *thumbnail.spectrum.shape), np.complex64)])
            self._norms = np.concatenate([self._norms, np.zeros((more, *thumbnail.as_earlier.shape), np.float32)])
        self._rows[frame] = count
        self._spectra[count], self._norms[count] = thumbnail.spectrum, thumbnail.as_earlier

    def retain(self, frames: Container[int]) -> None:
        """Remove the thumbnails of all but some frames."""
        left = [(frame, row) for frame, row in self._rows.items() if frame in frames]
        rows = [row for _, row in left]
        self._spectra, self._norms = self._spectra[rows], self._norms[rows]
        self._rows = {frame: row for row, (frame, _) in enumerate(left)}

    def candidates(self, thumbnail: Thumbnail, frames: Sequence[int], limit: int) -> list[Candidate]:
        """Return the frames that probably show the place of a thumbnail, the most probable first.

        Parameters
        ----------
        thumbnail : Thumbnail
            Of the later frame.
        frames : sequence of int
            Numbers of the frames in the index to compare it with.
        limit : int
            Largest number of candidates.
        """
        rows = np.array([self._rows[frame] for frame in frames], np.int64)
        best, at = np.empty(len(rows), np.float32), np.empty(len(rows), np.int64)
        for begin in range(0, len(rows), _BATCH):
            some = slice(begin, begin + _BATCH)
            alike = self._at_shifts(np.conj(self._spectra[rows[some]]) * thumbnail.spectrum)
            alike *= self._norms[rows[some]] * thumbnail.as_later
            np.clip(alike, 0.0, _MAX_CORRELATION, out=alike)
            likelihood = (-0.5 * self._values * np.log1p(-alike * alike)).reshape(len(alike), -1)
            best[some], at[some] = likelihood.max(axis=1), likelihood.argmax(axis=1)
        odds = best - np.log(np.count_nonzero(self._values)) - np.log(max(len(rows), 1))
        found = []
        for k in np.argsort(-odds)[:limit].tolist():
            if odds[k] > 0:
                down, across = (int(self._shifts[v]) for v in divmod(int(at[k]), len(self._shifts)))
                found.append(Candidate(frames[k], float(odds[k]), Displacement(-CELL_PX * down, -CELL_PX * across)))
        return found

    def _transform(self, cells: NDArray[np.float32]) -> NDArray[np.complex64]:
        spectrum: NDArray[np.complex64] = fft.rfft2(cells, (self._size, self._size))
        return spectrum

    def _at_shifts(self, spectra: NDArray[np.complex64]) -> NDArray[np.float32]:
        """Return correlations at the shifts that are searched, (..., shifts, shifts)."""
        whole = fft.irfft2(spectra, (self._size, self._size))
        return np.ascontiguousarray(whole[..., self._shifts[:, None], self._shifts], np.float32)
