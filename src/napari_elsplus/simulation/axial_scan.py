"""A scan of depths through raw frames: a stained plate moves away from the probe, as the paper measures sectioning."""

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
"""Mean grey level of the plate in contact, to which the light is set: single cores then stay below saturation."""


def scan_depths_um() -> NDArray[np.float64]:
    """Depths of a scan: 2 um apart near the focus, where ELS+ falls, 10 um apart where only LS is left."""
    return np.concatenate([np.arange(0, 120, 2), np.arange(120, 300, 5), np.arange(300, 701, 10)]).astype(np.float64)


def lit_for_plate(instrument: Instrument) -> Instrument:
    """Return the instrument with its light set for a plate in contact."""
    line, optics = instrument.line, instrument.optics
    reference = line_response(0.0, 0.0, optics.um(REFERENCE_SLIT_ROWS), line)
    contact = line_response(line.gap_um, 0.0, instrument.slit_um, line)
    share = float(contact / reference) * instrument.slit_rows / REFERENCE_SLIT_ROWS
    return replace(instrument, light_dn=CONTACT_DN / share)


class AxialScan:
    """Raw frames of a stained plate, one at each depth, rendered when they are asked for.

    Parameters
    ----------
    instrument : Instrument
        The instrument; the gap of its line model is added to every depth.
    depths_um : numpy.ndarray
        Distance of the plate from where it touches.
    seed : int
        Seed of the camera's noise.

    Examples
    --------
    >>> scan = AxialScan(lit_for_plate(Instrument.of("120hz")), scan_depths_um())
    >>> len(scan), bool(scan[0].mean() > 3 * scan[-1].mean())
    (137, True)
    """

    def __init__(self, instrument: Instrument, depths_um: NDArray[np.float64], *, seed: int = 0) -> None:
        self.instrument, self.depths_um = instrument, depths_um
        self._seed = seed

    def __len__(self) -> int:
        return len(self.depths_um)

    def __getitem__(self, index: int) -> NDArray[np.uint8]:
        """Render the frame at a depth (rows, cols)."""
        index = range(len(self))[index]
        scene = plate(float(self.depths_um[index]) + self.instrument.line.gap_um)
        return Renderer(self.instrument, scene, seed=self._seed).render(index)

    def __iter__(self) -> Iterator[NDArray[np.uint8]]:
        return (self[index] for index in range(len(self)))
