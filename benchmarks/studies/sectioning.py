"""Sectioning, signal, noise and the clipped rim against slit and offset: measured through the model's raw frames."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.processing.axial.axial_response import AxialResponse, axial_response
from napari_elsplus.processing.axial.profiles import axial_profiles
from napari_elsplus.processing.images.sectioning import Sectioner
from napari_elsplus.simulation.axial_scan import axial_scan, lit_for_plate, scan_depths_um
from napari_elsplus.simulation.calibration_scenes import background
from napari_elsplus.simulation.model.axial_response import LINE_MODELS, model_drop_offs
from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.simulation.rendering.renderer import Renderer
from napari_elsplus.simulation.specimen.scenes import paper, plate
from napari_elsplus.simulation.specimen.trajectories import Spiral
from napari_elsplus.simulation.truth import true_calibration
from napari_elsplus.workflows.sectioning_performance import SectioningPerformance, predict_performance

if TYPE_CHECKING:
    from numpy.typing import NDArray

SLIT_UM: Final = 2.9
WIDE_SLIT_UM: Final = 8.8
AVERAGED_FRAMES: Final = 300
CLIPPED_BELOW: Final = 0.5
"""Where the residual image has less than this share of its centre's brightness, the field counts as clipped."""


def measure_axial(instrument: Instrument, *, seed: int = 0, light: float = 1.0) -> AxialResponse:
    """Scan depths through raw frames (cores, noise, clipping, 8 bit) and analyse them as a recorded scan would be.

    Parameters
    ----------
    instrument : Instrument
        The instrument; its light is set for the plate.
    seed : int
        Seed of the camera's noise.
    light : float
        Of what the plate is usually lit with.
    """
    lit = lit_for_plate(instrument)
    lit = replace(lit, light_dn=light * lit.light_dn)
    depths_um = scan_depths_um()
    scan = axial_scan(lit, depths_um, seed=seed)
    calibration = true_calibration(lit, background(lit, seed=seed + 1))
    return axial_response(depths_um, *axial_profiles(scan, calibration))


def weigh_offset(offset_um: float) -> SectioningPerformance:
    """Work out what a slit offset costs and gives at the paper's usual slit and the 120 Hz preset's light level.

    The clipped field is that of rendered frames.
    """
    instrument = Instrument.of("120hz", slit_um=SLIT_UM, offset_um=-offset_um)
    trade = predict_performance(offset_um, SLIT_UM, instrument.line, instrument.light_dn)
    return replace(trade, clipped=clipped_share(instrument))


def clipped_share(instrument: Instrument) -> float:
    """Share of the cores whose residual signal of an in-focus plane is clipped at the rim."""
    bare = replace(instrument, autofluorescence=0.0)
    renderer = Renderer(bare, plate(0.0), noise=False)
    cores = instrument.bundle.cores()
    residual = renderer.core_values(0)[1] / cores.transmission
    centre = np.hypot(cores.rows_um, cores.cols_um) < 0.1 * instrument.bundle.diameter_um
    return float((residual < CLIPPED_BELOW * residual[centre].mean()).mean())


def mean_residual(offset_um: float) -> NDArray[np.float32]:
    """Average the residual images of a probe moving over stained paper, as the paper does to show its edge artefacts.

    Returns
    -------
    numpy.ndarray
        (n, n) float32 grey levels, the bundle's centre in the middle; the background is subtracted.
    """
    instrument = Instrument.of("120hz", slit_um=WIDE_SLIT_UM, offset_um=offset_um, rate_hz=10.0)
    instrument = replace(instrument, light_dn=instrument.light_dn / 3)  # three times the usual slit
    renderer = Renderer(instrument, paper(), Spiral(speed_um_s=3000.0))
    calibration = true_calibration(instrument, background(instrument, seed=1))
    sectioner = Sectioner(calibration, instrument.frame_shape)
    total = np.zeros((sectioner.side, sectioner.side), np.float32)
    raw = np.empty(instrument.frame_shape, np.uint8)
    image = np.empty_like(total)
    for k in range(AVERAGED_FRAMES):
        total += sectioner.residual(renderer.render(k, raw), image)
    return total / np.float32(AVERAGED_FRAMES)


def sharper_line_drop_offs(slits_um: NDArray[np.float64]) -> NDArray[np.float64]:
    """Drop-off distances of the sharper line at an offset of 77 um, closed form.

    Returns
    -------
    numpy.ndarray
        (slits, 4): LS 3 dB, LS 10 dB, ELS+ 3 dB and ELS+ 10 dB.
    """
    line = LINE_MODELS["b"]
    return np.array(
        [
            (
                *model_drop_offs(offset_um=None, slit_um=slit, line=line),
                *model_drop_offs(offset_um=77.0, slit_um=slit, line=line),
            )
            for slit in slits_um.tolist()
        ]
    )
