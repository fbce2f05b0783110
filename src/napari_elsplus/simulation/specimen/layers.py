"""Blurred planes of tissue, computed block by block around the probe, in a window that moves with it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Final

import cv2
import numpy as np

from napari_elsplus.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from napari_elsplus.simulation.specimen.textures import Texture

BLOCK: Final = 64
"""Side of a block, samples; chosen."""
SAMPLES_PER_SIGMA: Final = 2.0
"""Samples per standard deviation of the blur: enough for bilinear sampling; chosen."""
BLOCKS_AHEAD: Final = 4
"""Blocks computed ahead of the probe in each frame, so that all frames cost about the same; chosen."""
_MAX_BLOCKS: Final = 2048
"""Blocks in the cache, 32 MB."""


@dataclass(frozen=True, slots=True)
class Blur:
    """Standard deviations (um) by which a plane is blurred along rows' and columns' direction."""

    rows_um: float
    cols_um: float


class Layer:
    """A blurred plane on a regular grid, of which a window around the probe is in memory.

    Sample (i, j) lies at ``(i, j) * step_um`` in the scene and is stored at ``window[i & mask, j & mask]``: samples
    behind the probe are overwritten, and memory is independent of the path. A last row and a last column repeat the
    first ones, so that neighbours of a sample are always beside it. The most recent blocks (at most 32 MB) are cached
    for a probe that returns.

    Parameters
    ----------
    texture : Texture
        Brightness of the plane.
    blur : Blur
        Standard deviations of the blur.
    reach_um : float
        Half the width of the region that one frame shows.
    """

    def __init__(self, texture: Texture, blur: Blur, reach_um: float) -> None:
        self._texture = texture
        self.step_um: float = min(blur.rows_um, blur.cols_um) / SAMPLES_PER_SIGMA
        # Bilinear sampling blurs by a triangle of variance step^2 / 6: the filter leaves that much out.
        self._filters = tuple(
            _gaussian(np.sqrt(max((sigma / self.step_um) ** 2 - 1 / 6, 0.01))) for sigma in (blur.rows_um, blur.cols_um)
        )
        needed = 2 * reach_um / self.step_um + 3 * BLOCK
        self.size = 1 << int(np.ceil(np.log2(needed)))
        self.window: NDArray[np.float32] = np.zeros((self.size + 1, self.size + 1), np.float32)
        per_side = self.size // BLOCK
        self._held = np.full((per_side, per_side, 2), np.iinfo(np.int64).min)  # block in each slot
        self._ahead: list[tuple[int, int]] = []
        self._covered: list[range] = []
        self._block = lru_cache(_MAX_BLOCKS)(self._blurred)

    def cover(self, top_um: float, left_um: float, bottom_um: float, right_um: float) -> None:
        """Compute the window for a region of the scene: its top, left, bottom and right edge, um.

        Raises
        ------
        InputError
            If the region is larger than the window.
        """
        needed = self._blocks_of(((top_um, bottom_um), (left_um, right_um)))
        if needed != self._covered:
            self._covered = needed
            for block in self._missing(needed):
                self._fill(block)
            around = [range(span.start - 1, span.stop + 1) for span in needed]
            fits = all(len(span) <= self.size // BLOCK for span in around)
            self._ahead = self._missing(around) if fits else []
        for block in self._ahead[-BLOCKS_AHEAD:]:
            self._fill(block)
        del self._ahead[-BLOCKS_AHEAD:]

    def _blocks_of(self, region_um: tuple[tuple[float, float], tuple[float, float]]) -> list[range]:
        spans = []
        for low, high in region_um:
            first = int(np.floor(low / self.step_um)) // BLOCK
            last = (int(np.floor(high / self.step_um)) + 1) // BLOCK
            if last - first >= self.size // BLOCK:
                raise InputError(
                    f"one frame spans {high - low:.4g} um of the scene, "
                    f"more than the {self.size * self.step_um:.0f} um that are held",
                    "move the probe more slowly",
                )
            spans.append(range(first, last + 1))
        return spans

    def _missing(self, spans: list[range]) -> list[tuple[int, int]]:
        rows, cols = (np.array(span) for span in spans)
        slots = np.ix_(rows % len(self._held), cols % len(self._held))
        missing = (self._held[slots] != np.stack(np.broadcast_arrays(rows[:, None], cols), axis=-1)).any(-1)
        return [(int(rows[m]), int(cols[n])) for m, n in np.argwhere(missing)]

    def _fill(self, block: tuple[int, int]) -> None:
        slot = block[0] % len(self._held), block[1] % len(self._held)
        row, col = slot[0] * BLOCK, slot[1] * BLOCK
        self.window[row : row + BLOCK, col : col + BLOCK] = self._block(*block)
        if not row:
            self.window[-1, col : col + BLOCK] = self.window[0, col : col + BLOCK]
        if not col:
            self.window[row : row + BLOCK, -1] = self.window[row : row + BLOCK, 0]
        if not (row or col):
            self.window[-1, -1] = self.window[0, 0]
        self._held[slot] = block

    def _blurred(self, i: int, j: int) -> NDArray[np.float32]:
        margins = [len(taps) // 2 for taps in self._filters]
        rows, cols = (
            (np.arange(-margin, BLOCK + margin, dtype=np.float64) + index * BLOCK) * self.step_um
            for index, margin in zip((i, j), margins, strict=True)
        )
        blurred = cv2.sepFilter2D(self._texture.sample(rows, cols), -1, self._filters[1], self._filters[0])
        inside = (slice(margin, margin + BLOCK) for margin in margins)
        block: NDArray[np.float32] = blurred[tuple(inside)].copy()
        return block


def join_windows(layers: Sequence[Layer]) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Put the windows of layers one after the other into one array, where they stay.

    Parameters
    ----------
    layers : sequence of Layer
        Of any size, or none.

    Returns
    -------
    samples : numpy.ndarray
        All windows, row after row.
    first : numpy.ndarray
        (layers,) index of each window's first sample.
    """
    ends = np.cumsum([layer.window.size for layer in layers], dtype=np.int64)
    samples = np.zeros(ends[-1] if len(layers) else 0, np.float32)
    first = np.array([0, *ends[:-1]], np.int64)[: len(layers)]
    for layer, begin, end in zip(layers, first, ends, strict=True):
        joined = samples[begin:end].reshape(layer.window.shape)
        joined[:] = layer.window
        layer.window = joined
    return samples, first


def _gaussian(sigma: float) -> NDArray[np.float32]:
    reach = int(np.ceil(4 * sigma)) + 1
    taps = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    return np.asarray(taps / taps.sum(), np.float32)
