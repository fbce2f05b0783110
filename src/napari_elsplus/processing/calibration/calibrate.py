"""All of the calibration's steps together: frames in, the calibration out.

What one step finds serves the next: rows are taken at the bundle's centre column where the bundle is known.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.errors import InputError, MeasurementError
from napari_elsplus.instrument.calibration import (
    BundleSection,
    Calibration,
    FrameSection,
    GalvoSection,
    OffsetSection,
    OpticsSection,
    QualitySection,
)
from napari_elsplus.instrument.optics import BUNDLE_UM
from napari_elsplus.processing.analysis.image_quality import alignment_error
from napari_elsplus.processing.calibration.bundle.view_alignment import darkness
from napari_elsplus.processing.calibration.steps import (
    Background,
    BundlePair,
    SlitOffset,
    locate_pair,
    map_galvo,
    mean_frame,
    measure_background,
    measure_flat,
    measure_offset,
)
from napari_elsplus.processing.images.cores import CoreFilter
from napari_elsplus.processing.images.sectioning import Sectioner, disc

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from numpy.typing import NDArray

    from napari_elsplus.processing.calibration.galvo import GalvoMap
    from napari_elsplus.processing.images.sectioning import Frames

__all__ = [
    "Background",
    "BundlePair",
    "Findings",
    "SlitOffset",
    "locate_pair",
    "map_galvo",
    "mean_frame",
    "measure",
    "measure_background",
    "measure_flat",
    "measure_offset",
]

PARK_CLEARANCE_UM: Final = 120.0
"""A halo's width is 100 um; a fifth more for what the galvo map does not know outside of the bundle."""


@dataclass(frozen=True, slots=True)
class Findings:
    """What was measured, step by step; absent what was not."""

    shape: tuple[int, int] | None = None
    offset: SlitOffset | None = None
    galvo: GalvoMap | None = None
    pair: BundlePair | None = None
    background: Background | None = None
    calibration: Calibration = field(default_factory=Calibration)


def measure(
    *,
    line: Frames | None = None,
    sweep: Frames | None = None,
    volts: NDArray[np.floating] | None = None,
    bundle: Frames | None = None,
    background: Frames | None = None,
    flat: Frames | None = None,
    um_per_px: float | None = None,
    bundle_um: float | None = None,
    line_period_s: float | None = None,
    line_periods_per_frame: float | None = None,
    watch: Callable[[Iterable[int]], Iterable[int]] = iter,
) -> Findings:
    """Make a calibration of any subset of its inputs.

    Parameters
    ----------
    line, sweep, bundle, background, flat : sequence of numpy.ndarray, optional
        Raw frames (rows, cols): the line standing still; the line at each of `volts`; the bundle lit from the far end;
        a dark tube; a uniform scene.
    volts : numpy.ndarray, optional
        A voltage per frame of `sweep`.
    um_per_px, bundle_um : float, optional
        Scale, or the bundle's diameter from which it follows.
    line_period_s, line_periods_per_frame : float, optional
        Timing.
    watch : callable, optional
        Wraps the numbers of the sweep's frames, to show how far it is.

    Returns
    -------
    Findings
        The steps' results with their uncertainties, and the calibration made of them.

    Raises
    ------
    InputError
        If inputs are missing, disagree in shape, or make no sense together.
    MeasurementError
        If a step finds no line or no pair.
    """
    inputs = {"line": line, "sweep": sweep, "bundle": bundle, "background": background, "flat": flat}
    shape = _common_shape({name: frames for name, frames in inputs.items() if frames is not None})
    if (sweep is None) != (volts is None):
        raise InputError(
            *(
                ("voltages without a sweep", "give --sweep")
                if sweep is None
                else ("a sweep without voltages", "give --volts")
            )
        )
    if um_per_px is not None and bundle_um is not None:
        raise InputError(f"two scales, {um_per_px} um per pixel and a bundle of {bundle_um} um", "give one of them")
    if bundle_um is not None and bundle is None:
        raise InputError(f"a bundle of {bundle_um} um gives no scale without its image", "give --bundle or --um-per-px")
    if flat is not None and bundle is None:
        raise InputError("a flat field belongs to a located bundle", "give --bundle")
    dark = None if background is None else measure_background(background)
    mean = None if dark is None else dark.mean
    pair = None if bundle is None else locate_pair(bundle)
    offset = None if line is None else measure_offset(line, mean, pair)
    galvo = None if sweep is None or volts is None else map_galvo(sweep, volts, mean, pair, watch)
    if pair is not None and bundle_um is not None:
        um_per_px = bundle_um / pair.left.diameter_px
    calibration = Calibration(
        frame=None if shape is None else FrameSection(shape=shape),
        offset=None if offset is None else offset_section(offset),
        galvo=None if galvo is None else galvo_section(galvo, pair, um_per_px),
        bundle=None if pair is None else bundle_section(pair),
        optics=_optics_section(um_per_px, line_period_s, line_periods_per_frame),
        background=mean,
    )
    if pair is not None and bundle is not None:
        calibration = with_flat_and_quality(calibration, pair, bundle, flat)
    return Findings(shape, offset, galvo, pair, dark, calibration)


def _common_shape(inputs: dict[str, Frames]) -> tuple[int, int] | None:
    shapes = {}
    for name, frames in inputs.items():
        if not len(frames):
            raise InputError(f"{name}: there are 0 frames", "give at least one")
        shape = frames[0].shape
        if len(shape) != 2:
            raise InputError(f"{name}: a frame has shape {shape}", "frames (rows, cols) are expected")
        shapes[name] = shape
    for name, shape in shapes.items():
        first = next(iter(shapes))
        if shape != shapes[first]:
            raise InputError(
                f"{first} has {shapes[first][0]} x {shapes[first][1]} pixels, {name} {shape[0]} x {shape[1]}",
                "record all with the same camera region",
            )
    return next(iter(shapes.values()), None)


def offset_section(offset: SlitOffset) -> OffsetSection:
    """Write down what a calibration keeps of the slit offset."""
    return OffsetSection(rows=offset.rows, uncertainty_rows=offset.uncertainty_rows, tilt_deg=offset.left.tilt_deg)


def galvo_section(galvo: GalvoMap, pair: BundlePair | None, um_per_px: float | None) -> GalvoSection:
    """Write down what a calibration keeps of the galvo map; with the pair, also where the mirror is parked."""
    park_v = None
    if pair is not None:
        clear = pair.left.diameter_px / 2 + PARK_CLEARANCE_UM / (um_per_px or BUNDLE_UM / pair.left.diameter_px)
        park_v = galvo.park_v(pair.left.centre[0] - clear, pair.left.centre[0] + clear)
    return GalvoSection(
        volts_per_row=galvo.volts_per_row,
        volts_at_row_zero=galvo.volts_at_row_zero,
        volts_per_row_uncertainty=galvo.volts_per_row_uncertainty,
        volts_at_row_zero_uncertainty=galvo.volts_at_row_zero_uncertainty,
        r_squared=galvo.r_squared,
        rms_rows=galvo.rms_rows,
        park_v=park_v,
    )


def bundle_section(pair: BundlePair) -> BundleSection:
    """Write down what a calibration keeps of the bundle pair."""
    top, bottom = (tuple(float(value) for value in row) for row in pair.alignment.residual_to_confocal)
    return BundleSection(
        confocal_centre=pair.left.centre,
        residual_centre=pair.right.centre,
        diameter_px=pair.left.diameter_px,
        residual_to_confocal=((top[0], top[1], top[2]), (bottom[0], bottom[1], bottom[2])),
        residual_gain=pair.alignment.gain,
        residual_gain_uncertainty=pair.alignment.gain_uncertainty,
        centre_uncertainty_px=pair.left.centre_uncertainty_px,
        diameter_uncertainty_px=pair.left.diameter_uncertainty_px,
        alignment_uncertainty_px=pair.alignment.uncertainty_px,
    )


def _optics_section(
    um_per_px: float | None, line_period_s: float | None, line_periods_per_frame: float | None
) -> OpticsSection | None:
    numbers = {"um_per_px": um_per_px, "line_period_s": line_period_s, "rows_per_frame": line_periods_per_frame}
    known = {name: value for name, value in numbers.items() if value is not None}
    for name, value in known.items():
        if not (np.isfinite(value) and value > 0):
            raise InputError(f"{name} is {value}", "it must be a positive number")
    return OpticsSection(**known) if known else None


def with_flat_and_quality(
    calibration: Calibration, pair: BundlePair, bundle: Frames, flat: Frames | None
) -> Calibration:
    """Add the flat field, and how well the two views cancel: both from light of the far end, above its darkness."""
    transmission = mean_frame(bundle)
    dark = darkness(transmission, pair.left, pair.right)
    above_dark = calibration.model_copy(update={"background": dark})
    image = None
    if flat is not None:
        image = measure_flat(flat, calibration if calibration.background is not None else above_dark)
    elif pair.shows_flat_field:
        image = measure_flat(bundle, above_dark)
    sectioner = Sectioner(above_dark, transmission.shape)
    views = [sectioner.ls(transmission), sectioner.residual(transmission)]
    inside = disc(sectioner.side, pair.left.diameter_px)
    try:
        smooth = CoreFilter.GAUSSIAN.prepared(image, inside)
    except MeasurementError:
        smooth = CoreFilter.MEDIAN.prepared(None, inside)
    quality = QualitySection(
        alignment_error=alignment_error(views[0], views[1], pair.left.diameter_px),
        alignment_error_filtered=alignment_error(smooth(views[0]), smooth(views[1]), pair.left.diameter_px),
    )
    return calibration.model_copy(update={"flat": image, "quality": quality})
