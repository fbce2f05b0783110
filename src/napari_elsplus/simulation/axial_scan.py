"""Axial scan in raw frames: a stained plate at increasing distance, the paper's measurement of sectioning."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from napari_elsplus.simulation.model.axial_response import line_response
from napari_elsplus.simulation.model.instrument import REFERENCE_SLIT_ROWS, Instrument
from napari_elsplus.simulation.rendering.frames import RenderedFrames
from napari_elsplus.simulation.rendering.renderer import Renderer
from napari_elsplus.simulation.specimen.scenes import plate

if TYPE_CHECKING:
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


def axial_scan(
    instrument: Instrument,
    depths_um: NDArray[np.float64],
    *,
    seed: int = 0,
    line_rows: NDArray[np.float64] | None = None,
) -> RenderedFrames:
    """Return raw frames of a stained plate, one at each depth.

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
    >>> scan = axial_scan(lit_for_plate(Instrument.of("120hz")), scan_depths_um())
    >>> len(scan), bool(scan[0].mean() > 3 * scan[-1].mean())
    (137, True)
    """
    kept: dict[float, Renderer] = {}  # where the plate comes back to a depth

    def render(index: int) -> NDArray[np.uint8]:
        depth_um = float(depths_um[index])
        renderer = kept.get(depth_um) or Renderer(instrument, plate(depth_um + instrument.line.gap_um), seed=seed)
        if np.count_nonzero(depths_um == depth_um) > 1:
            kept[depth_um] = renderer
        return renderer.render(index, line_rows=line_rows)

    return RenderedFrames(render, len(depths_um))
