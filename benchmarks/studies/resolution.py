"""Lateral resolution of the camera's modes: bars of a USAF 1951 target, lit from behind as in the paper."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from benchmarks.rigs.simulated import StopAndGo, measured
from napari_elsplus.instrument.optics import CORE_PITCH_UM, PRESETS, Optics
from napari_elsplus.processing.analysis.resolution import RESOLVED_CONTRAST, BarElement, element_contrast
from napari_elsplus.processing.images.cores import CoreFilter
from napari_elsplus.processing.images.sectioning import Sectioner
from napari_elsplus.simulation.model.bundle import Bundle
from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.simulation.specimen.pictures import Bars
from napari_elsplus.simulation.specimen.scenes import Plane, Scene

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Image = NDArray[np.float32]

PAPER: Final = {
    "120 Hz": "5.52, with the median",
    "240 Hz": "8.8, unfiltered",
    "240 Hz, under-sampled": "8.8, unfiltered",
    "240 Hz, 10x, cropped": "proposed",
}
"""The paper's resolution by mode, um."""
ELEMENTS: Final = tuple((group, element) for group in (5, 6, 7) for element in range(1, 7))[4:]
"""Group and element of the target's bars, coarse to fine: line pairs of 19.7 to 4.4 um."""
PLACES: Final = 24
"""Places of the target before the cores; chosen: 48 images of each element, two ways at each place."""
SEEN: Final = 0.9
"""Share of the images of an element in which it must be resolved; chosen: a reader has one image of it, in which the
lattice of cores may hide it or not."""
SPREAD_UM: Final = 10.0
"""Standard deviation of these places along either axis; chosen: three cores."""
SHOWN_UM: Final = 350.0
"""Side of the pictures; derived: the target with its places before the cores."""
CROPPED_UM: Final = 460.0
"""Diameter of the bundle that a mask leaves of the 10x objective's image in the rows of the 240 Hz mode, um; derived:
524 rows of 0.96 um less the slit offset of 29 um, and a margin."""
UNDERSAMPLED_PX: Final = 1.2
"""Pixels per core of a mode that under-samples the bundle, as the paper states of its 240 Hz mode, whose 2.4 pixels
per core do not; its 6.8 pixels at 120 Hz are likewise twice those of its magnification."""


@dataclass(frozen=True)
class Resolved:
    """Resolution of a mode of the camera.

    Parameters
    ----------
    px_per_core : float
        Camera pixels per core pitch.
    field_um : float
        Diameter of the imaged part of the bundle.
    line_pair_um : dict
        Finest resolved line pair after each core filter; NaN where none is.
    image : numpy.ndarray
        Confocal view of the target, unfiltered, the middle :data:`SHOWN_UM` of the field.
    """

    px_per_core: float
    field_um: float
    line_pair_um: dict[CoreFilter, float]
    image: Image


def modes() -> dict[str, Instrument]:
    """Return the camera's modes by name: the paper's two, one that under-samples, and the one that it proposes."""
    fast = PRESETS["240hz"]
    coarse = Optics(CORE_PITCH_UM / UNDERSAMPLED_PX, line_periods_per_frame=fast.optics.line_periods_per_frame)
    fine = replace(PRESETS["120hz"].optics, line_periods_per_frame=fast.optics.line_periods_per_frame)
    usual = Instrument.of("240hz")
    return {
        "120 Hz": Instrument.of("120hz"),
        "240 Hz": usual,
        "240 Hz, under-sampled": replace(usual, preset=replace(fast, optics=coarse)),
        "240 Hz, 10x, cropped": replace(
            usual,
            preset=replace(fast, objective="10x", optics=fine),
            offset_rows=fine.rows(usual.offset_um),
            bundle=Bundle(diameter_um=CROPPED_UM),
        ),
    }


def measure_mode(instrument: Instrument, places: int = PLACES, seed: int = 0) -> Resolved:
    """Measure the finest line pair that an instrument resolves in the confocal view, unfiltered and after the median.

    Parameters
    ----------
    instrument : Instrument
        The mode.
    places : int
        Places of the target before the cores.
    seed : int
        Seed of places and noise.

    Returns
    -------
    Resolved
        Down to which at least :data:`SEEN` of the images have a contrast of :data:`RESOLVED_CONTRAST` or more.
    """
    rig = measured(instrument)
    scene, boxes_um = target()
    at_um = np.random.default_rng(seed).normal(0, SPREAD_UM, (places, 2))
    frames = rig.recording(scene, StopAndGo(at_um, instrument.optics.frame_period_s), places, seed=seed)
    sectioner = Sectioner(rig.calibration.model_copy(update={"background": None}), instrument.frame_shape)
    images = [sectioner.ls(frame) - np.float32(instrument.black_dn) for frame in frames]
    finest = {}
    for cores in (CoreFilter.NONE, CoreFilter.MEDIAN):
        smooth = cores.prepared(None, np.ones_like(images[0], bool))
        contrast = [
            [
                [element_contrast(shown, _placed(way, place_um, sectioner, rig.um_per_px)) for way in ways]
                for ways in boxes_um
            ]
            for shown, place_um in zip(map(smooth, images), at_um, strict=True)
        ]
        finest[cores] = _finest_um(np.quantile(contrast, 1 - SEEN, axis=(0, 2)))
    edge = round((sectioner.side - SHOWN_UM / rig.um_per_px) / 2)
    shown = images[0][edge:-edge, edge:-edge]
    return Resolved(CORE_PITCH_UM / rig.um_per_px, instrument.bundle.diameter_um, finest, shown)


def target() -> tuple[Scene, list[tuple[BarElement, BarElement]]]:
    """Return the target, and each element's bars along rows and along columns, in micrometres of the scene."""
    ways, left, top = [], -150.0, -130.0
    for group, element in ELEMENTS:
        period_um = 1000 / 2 ** (group + (element - 1) / 6)
        width = period_um / 2
        if left + 11 * width > 150:
            left, top = -150.0, top + 70.0
        along = tuple((top + 2 * n * width, left, top + (2 * n + 1) * width, left + 5 * width) for n in range(3))
        across = tuple((top, left + (6 + 2 * n) * width, top + 5 * width, left + (7 + 2 * n) * width) for n in range(3))
        ways.append((BarElement(period_um, along), BarElement(period_um, across)))
        left += 13 * width
    bars = tuple(bar for pair in ways for way in pair for bar in way.bars_px)
    return Scene((Plane(Bars(bars)),), transmission=True), ways


def _placed(element: BarElement, place_um: NDArray[np.float64], sectioner: Sectioner, um_per_px: float) -> BarElement:
    """Return the bars in pixels of an image, the probe at a place."""
    shift = np.array([*place_um, *place_um])
    middle = sectioner.side / 2
    bars = tuple(tuple(((np.array(bar) - shift) / um_per_px + middle).tolist()) for bar in element.bars_px)
    return BarElement(element.line_pair_um, bars)


def _finest_um(contrast: NDArray[np.float64]) -> float:
    resolved = np.flatnonzero(~np.logical_and.accumulate(contrast >= RESOLVED_CONTRAST))
    count = int(resolved[0]) if len(resolved) else len(contrast)
    if not count:
        return float("nan")
    group, element = ELEMENTS[count - 1]
    return float(1000 / 2 ** (group + (element - 1) / 6))
