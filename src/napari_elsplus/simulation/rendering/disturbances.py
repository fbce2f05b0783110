"""What disturbs an imperfect instrument's frames from row to row and from frame to frame."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.simulation.model.imperfections import Imperfections
    from napari_elsplus.simulation.model.instrument import Instrument

    Values = NDArray[np.float32]

_ROW_NOISE = 1
"""First word of the seeds, so that no two disturbances share their random numbers."""


class Readout(NamedTuple):
    """Deviations of one frame's readout.

    ``row_black_dn`` is (rows,) float32: grey levels added to each row.
    """

    row_black_dn: Values


class Disturbances:
    """Disturbances of the frames of one imperfect instrument; the same seed and frame give the same ones.

    Parameters
    ----------
    instrument : Instrument
        The instrument, with its imperfections.
    seed : int
        Seed of the camera's noise.
    """

    def __init__(self, instrument: Instrument, seed: int) -> None:
        self._instrument, self._seed = instrument, seed

    @property
    def _imperfections(self) -> Imperfections:
        return self._instrument.imperfections

    def readout(self, frame_index: int) -> Readout | None:
        """Return the deviations of a frame's readout, by the frame's index; None if it has none."""
        if not self._imperfections.row_noise_dn:
            return None
        rows = self._instrument.frame_shape[0]
        noise = self._rng(_ROW_NOISE, frame_index).normal(0, self._imperfections.row_noise_dn, rows)
        return Readout(noise.astype(np.float32))

    def _rng(self, kind: int, frame_index: int) -> np.random.Generator:
        return np.random.default_rng((kind, self._seed, frame_index))
