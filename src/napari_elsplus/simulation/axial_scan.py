"""Axial scan in raw frames: a stained plate at increasing distance, the paper's measurement of sectioning."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from napari_elsplus.simulation.model.axial_response import line_response
from napari_elsplus.simulation.model.instrument import REFERENCE_SLIT_ROWS, Instrument
from napari_elsplus.simulation.rendering.renderer import Renderer
from napari_elsplus.simulation.specimen.scenes import plate

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

CONTACT_DN = 100.0
"""Mean grey level of the plate in contact, at which single cores stay below 255; chosen."""


def scan_depths_um() -> NDArray[np.float64]:
    """Return the depths of a scan, (137,) um: steps of 2 um to 120 um, where ELS+ falls, then 5 and 10 um to 700 um."""
    return np.concatenate([np.arange(0, 120, 2), np.arange(120, 300, 5), np.arange(300, 701, 10)]).astype(np.float64)


def lit_for_plate(instrument: Instrument) -> Instrument:
    """Return the instrument with `light_dn` set so that a plate in contact has the mean grey level `CONTACT_DN`."""
    line, optics = instrument.line, instrument.optics
    reference = line_response(0.0, 0.0, optics.um(REFERENCE_SLIT_ROWS), line)
    contact = line_response(line.gap_um, 0.0, instrument.slit_um, line)
    share = float(contact / reference) * instrument.slit_rows / REFERENCE_SLIT_ROWS
    return replace(instrument, light_dn=CONTACT_DN / share)


class AxialScan:
    """Sequence of raw frames of a stained plate, one at each depth, rendered on access.

    Parameters
    ----------
    instrument : Instrument
        The instrument; the gap of its line model is added to each depth.
    depths_um : numpy.ndarray
        (n,) distances of the plate from contact, um.
    seed : int
        Seed of the camera's noise.
    line_rows : numpy.ndarray, optional
        (rows,) line positions; see :meth:`Renderer.render`.

    Examples
    --------
    >>> scan = AxialScan(lit_for_plate(Instrument.of("120hz")), scan_depths_um())
    >>> len(scan), bool(scan[0].mean() > 3 * scan[-1].mean())
    (137, True)
    """

    def __init__(
        self,
        instrument: Instrument,
        depths_um: NDArray[np.float64],
        *,
        seed: int = 0,
        line_rows: NDArray[np.float64] | None = None,
    ) -> None:
        self.instrument, self.depths_um = instrument, depths_um
        self._seed, self._line_rows = seed, line_rows
        self._renderers: dict[float, Renderer] = {}

    def __len__(self) -> int:
        return len(self.depths_um)

    def __getitem__(self, index: int) -> NDArray[np.uint8]:
        """Return the frame (rows, cols), uint8, at the depth of this index."""
        index = range(len(self))[index]
        return self._renderer(float(self.depths_um[index])).render(index, line_rows=self._line_rows)

    def __iter__(self) -> Iterator[NDArray[np.uint8]]:
        return (self[index] for index in range(len(self)))

    def _renderer(self, depth_um: float) -> Renderer:
        """Return the renderer of a depth, kept where the plate comes back to it."""
        if depth_um not in self._renderers:
            renderer = Renderer(self.instrument, plate(depth_um + self.instrument.line.gap_um), seed=self._seed)
            if np.count_nonzero(self.depths_um == depth_um) == 1:
                return renderer
            self._renderers[depth_um] = renderer
        return self._renderers[depth_um]
