"""Predict drop-offs, signal and noise of ELS+ for a slit offset and a measured line, in less than a frame period."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.instrument.optics import BUNDLE_UM
from napari_elsplus.processing.analysis.slit_offset import contrast_to_noise
from napari_elsplus.processing.tracking.front_end.grid import overlap_of_discs
from napari_elsplus.simulation.model.axial_response import (
    LINE_MODELS,
    LineModel,
    line_response,
    model_drop_offs,
    signal_kept,
)

if TYPE_CHECKING:
    from napari_elsplus.processing.calibration.line.location import Line

ELECTRONS_PER_DN: Final = 40.0
"""Electrons per grey level of an 8-bit camera at 0 dB; assumed, since frames of a line do not constrain it."""
READ_NOISE_E: Final = 12.0
"""Read noise in electrons, one standard deviation; assumed, as the gain is."""
_MIN_CORE_UM: Final = 0.5
"""Lower limit of the line's core width, micrometres: below the diffraction limit of the bundle's optics."""


@dataclass(frozen=True, slots=True)
class SectioningPerformance:
    """Predicted sectioning, signal and noise of ELS+ for a slit offset.

    Parameters
    ----------
    drop_3db_um, drop_10db_um : float
        Depths in micrometres at which ELS+ has fallen to a half and to a tenth of its value in contact.
    signal_kept : float
        ELS+ over LS in contact.
    contrast_to_noise : float
        Of an in-focus plane as bright as the line, in one pixel of one frame.
    clipped : float
        Fraction of the field whose residual slit lies outside of the bundle.
    """

    drop_3db_um: float
    drop_10db_um: float
    signal_kept: float
    contrast_to_noise: float
    clipped: float


def line_as_seen(seen: Line, slit_rows: float, um_per_px: float) -> LineModel:
    """Return the line model with its core as wide as measured; the halo, which the fit does not constrain, is nominal.

    Parameters
    ----------
    seen : Line
        The standing line.
    slit_rows : float
        Rows that are exposed at once; they widen the measured line.
    um_per_px : float
        Micrometres per camera pixel.
    """
    model = LINE_MODELS["a"]
    core_rows = np.sqrt(max(seen.width_rows**2 - slit_rows**2 / 12, 0.0))
    core_um = float(np.clip(core_rows * um_per_px, _MIN_CORE_UM, 0.9 * model.halo_um))
    return replace(model, core_um=core_um)


def predict_performance(
    offset_um: float,
    slit_um: float,
    line: LineModel,
    light_dn: float,
    *,
    gain_db: float = 0.0,
    bundle_um: float = BUNDLE_UM,
) -> SectioningPerformance:
    """Predict drop-offs, signal kept, noise and clipping of ELS+ for a slit offset.

    Parameters
    ----------
    offset_um : float
        Slit offset, either sign, not zero.
    slit_um : float
        Width of the slit at the bundle.
    line : LineModel
        The laser line.
    light_dn : float
        Grey levels of the line in focus.
    gain_db : float
        Of the camera.
    bundle_um : float
        Diameter of the bundle's image.

    Returns
    -------
    SectioningPerformance

    Examples
    --------
    >>> at_29_um = predict_performance(-29.0, 2.9, LINE_MODELS["a"], 80.0)
    >>> round(at_29_um.drop_10db_um), round(at_29_um.signal_kept, 2), round(at_29_um.clipped, 2)
    (120, 0.82, 0.06)
    """
    offset_um = abs(offset_um)
    drops = model_drop_offs(offset_um=offset_um, slit_um=slit_um, line=line)
    aside = line_response(0.0, offset_um, slit_um, line) / line_response(0.0, 0.0, slit_um, line)
    confocal_e = max(light_dn, 0.0) * ELECTRONS_PER_DN / 10 ** (gain_db / 20)
    noise = contrast_to_noise(confocal_e, confocal_e * float(aside), np.sqrt(2) * READ_NOISE_E)
    return SectioningPerformance(
        drops.drop_3db_um,
        drops.drop_10db_um,
        signal_kept(offset_um=offset_um, slit_um=slit_um, line=line),
        float(noise),
        1 - overlap_of_discs(offset_um / bundle_um),
    )
