"""Recognition of places by thumbnails: which earlier nodes show what a node shows, over all shifts.

A thumbnail is a frame freed of its motion and its rotation, high-passed, in cells of eight grid pixels. Its correlation
with another over all shifts takes one inverse Fourier transform of 48 x 48, some 20 us, so that a node is compared with
all of thousands; only candidates are registered. The odds of a shift with correlation r over n independent values are
-n/2 ln(1 - r^2) nats, less the logarithms of the numbers of shifts and of thumbnails.
"""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING, Final, NamedTuple

import cv2
import numpy as np

from napari_elsplus.processing.tracking.front_end.grid import FIELD
from napari_elsplus.processing.tracking.registration.masked_correlation import (
    MAX_CORRELATION,
    CoarseImage,
    MaskedCorrelation,
    high_passed,
)
from napari_elsplus.processing.tracking.registration.motion_models import turned_by, unsheared, upright

if TYPE_CHECKING:
    from collections.abc import Mapping

    from napari_elsplus.processing.tracking.front_end.grid import Grid
    from napari_elsplus.processing.tracking.motion.rolling_shutter import Velocity
    from napari_elsplus.processing.tracking.registration.pair_registration import PreparedFrame

CELL_PX: Final = 8
"""Grid pixels per cell; chosen: about 26 cells across the field, one inverse transform of 48 x 48 a pair."""
MIN_OVERLAP: Final = 0.25
"""Smallest overlap that is searched, fraction of the field; chosen: with less, right shifts do not stand out."""
_REACH: Final = 0.65
"""Largest shift that is searched, diameters of the field; derived: the overlap of discs is a quarter there."""
_LEVEL: Final = 2
"""Level of the pyramid from which thumbnails are averaged: quarter resolution."""
_HIGH_PASS_CELLS: Final = 3.0
"""Standard deviation of the high-pass; chosen: brightness that varies over half of the field is removed."""
_CELLS_PER_VALUE: Final = 2.0
"""Cells that share one independent value; chosen, so that of unrelated nuclei one in ten thousand has positive odds."""


class Candidate(NamedTuple):
    """A node that probably shows the same place.

    Parameters
    ----------
    node : int
        Its number.
    turn : float
        By which this node's thumbnail was turned that resembles the other one most, radians.
    odds : float
        Log odds of the best shift against unrelated frames at all shifts, nats.
    displacement : complex
        Of the other node from this one, upright, row + i col, grid pixels; known to about one cell.
    """

    node: int
    turn: float
    odds: float
    displacement: complex


class PlaceRecognition(MaskedCorrelation):
    """Makes thumbnails and compares them over all shifts.

    Parameters
    ----------
    grid : Grid
        Tracking grid.
    """

    def __init__(self, grid: Grid) -> None:
        self._grid, cells = grid, grid.side // CELL_PX
        y, x = (CELL_PX * (np.arange(cells) + 0.5) - 0.5 - c for c in grid.centre)
        mask = (np.hypot(y[:, None], x) < 0.5 * FIELD * grid.diameter - CELL_PX / 2).astype(np.float32)
        super().__init__(mask, MIN_OVERLAP, int(_REACH * FIELD * grid.diameter / CELL_PX))
        self._half_values = np.where(self.searched, self.overlap / np.float32(2 * _CELLS_PER_VALUE), np.float32(0))
        self._upright = np.zeros((grid.side >> _LEVEL,) * 2, np.float32)

    def thumbnail(self, view: PreparedFrame, velocity: Velocity, angle: float) -> CoarseImage:
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
        image = upright(view.levels[_LEVEL], self._upright, self._grid.binned(2**_LEVEL).centre, matrix)
        cells = len(self._mask)
        used = cells * (CELL_PX >> _LEVEL)
        small = cv2.resize(image[:used, :used], (cells, cells), interpolation=cv2.INTER_AREA)
        return self.prepare(high_passed(small, self._mask, _HIGH_PASS_CELLS))

    def candidates(
        self, seen: Mapping[float, CoarseImage], others: Mapping[int, CoarseImage], limit: int
    ) -> list[Candidate]:
        """Return the nodes that probably show the place of a thumbnail, the most probable first.

        Parameters
        ----------
        seen : mapping of float to CoarseImage
            Thumbnails of the later node by the turn at which each was made, radians.
        others : mapping of int to CoarseImage
            Those of the nodes to compare it with.
        limit : int
            Largest number of candidates.
        """
        found: dict[int, Candidate] = {}
        templates = {turn: thumbnail.as_template for turn, thumbnail in seen.items()}
        for (turn, here), (node, other) in product(templates.items(), others.items()):
            alike = np.clip(self.coefficients(here, other), 0.0, MAX_CORRELATION)
            likelihood = -self._half_values * np.log1p(-alike * alike)
            row, col = divmod(int(likelihood.argmax()), len(self.lags))
            odds, before = float(likelihood[row, col]), found.get(node)
            if before is None or odds > before.odds:
                found[node] = Candidate(node, turn, odds, CELL_PX * complex(*self.lags[[row, col]]))
        tried = np.log(np.count_nonzero(self._half_values)) + np.log(max(len(seen) * len(others), 1))
        best = sorted(found.values(), key=lambda candidate: -candidate.odds)[:limit]
        return [one._replace(odds=one.odds - tried) for one in best if one.odds > tried]
