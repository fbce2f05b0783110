"""Results of the calibration's steps as sections of the calibration."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from napari_elsplus.errors import InputError, MeasurementError
from napari_elsplus.instrument.calibration import (
    BundleSection,
    Calibration,
    GalvoSection,
    OffsetSection,
    QualitySection,
)
from napari_elsplus.instrument.optics import BUNDLE_UM, PARK_CLEARANCE_UM
from napari_elsplus.processing.calibration.bundle.cancellation import measure_alignment_errors
from napari_elsplus.processing.calibration.bundle.gain import darkness
from napari_elsplus.processing.calibration.bundle.gain_map import measure_gain_map
from napari_elsplus.processing.calibration.bundle.laser_gain import (
    LAMP_GAIN,
    MAX_DISAGREEMENT,
    SweptLight,
    laser_gain,
    swept_flat_field,
)
from napari_elsplus.processing.calibration.bundle.pair import MAX_STRUCTURE, BundlePair, structure_of_light
from napari_elsplus.processing.calibration.measurements import Background, measure_flat_field
from napari_elsplus.processing.calibration.slit_offset import SlitOffset, offset_at
from napari_elsplus.processing.images.hot_pixels import HotPixels
from napari_elsplus.processing.images.resampling import crop_to_frame, within_frame
from napari_elsplus.processing.images.sectioning import disc

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.processing.calibration.draft import Draft
    from napari_elsplus.processing.calibration.galvo import GalvoMap
    from napari_elsplus.processing.calibration.scan.lag import ScanLag

    Image = NDArray[np.float32]


STRETCHES: Final = (0.5, 2.0)
"""Smallest and largest change of areas from the residual to the confocal view; those that a bundle section accepts."""
_OF_SCAN: Final = ("lag_s", "natural_hz", "damping", "rows_off", "highest_rate_hz")
"""Fields of the galvo section that the scan lag's step measures; a new galvo map keeps them."""


def apply_offset(draft: Draft, offset: SlitOffset) -> Calibration:
    """Return the draft's calibration with a slit offset, taken at the bundle pair where it is known."""
    seen = offset if draft.pair is None else offset_at(offset, draft.pair)
    section = OffsetSection(
        rows=seen.rows,
        uncertainty_rows=seen.uncertainty_rows,
        tilt_deg=seen.confocal.tilt_deg,
        **({} if seen.parts is None else asdict(seen.parts)),
    )
    return draft.calibration.model_copy(update={"offset": section})


def apply_galvo(draft: Draft, galvo: GalvoMap) -> Calibration:
    """Return the draft's calibration with a galvo map; with the bundle pair, also with the voltage for parking."""
    pair, known, park_v = draft.pair, draft.calibration, None
    before = known.galvo
    if pair is not None:
        centre, diameter_px = pair.confocal.centre, pair.confocal.diameter_px
        galvo = galvo.at_column(centre[1])
        clear = diameter_px / 2 + PARK_CLEARANCE_UM / (draft.um_per_px or BUNDLE_UM / diameter_px)
        park_v = galvo.park_v(centre[0] - clear, centre[0] + clear)
    elif before is not None:
        park_v = before.park_v
    section = GalvoSection(
        volts_per_row=galvo.volts_per_row,
        volts_at_row_zero=galvo.volts_at_row_zero,
        volts_per_row_uncertainty=galvo.volts_per_row_uncertainty,
        volts_at_row_zero_uncertainty=galvo.volts_at_row_zero_uncertainty,
        r_squared=galvo.r_squared,
        rms_rows=galvo.rms_rows,
        park_v=park_v,
        bow_rows=galvo.bow_rows,
        bow_uncertainty_rows=galvo.bow_uncertainty_rows,
        **({} if before is None else {name: getattr(before, name) for name in _OF_SCAN}),
    )
    known = known.model_copy(update={"galvo": section})
    if pair is None or galvo.light is None:
        return known
    return _with_swept_flat_field(_in_laser_light(known, pair, galvo.light), pair, galvo.light)


def apply_pair(draft: Draft, pair: BundlePair) -> Calibration:
    """Return the draft's calibration with a bundle pair: bundle, scale, flat field, quality; offset and galvo at it.

    Parameters
    ----------
    draft : Draft
        Contains the pair.
    pair : BundlePair
        Located.

    Raises
    ------
    MeasurementError
        If the two views do not fit each other.
    """
    distortion = None if pair.alignment.distortion is None else pair.alignment.distortion.astype(np.float32)
    known = draft.calibration.model_copy(update={"bundle": _bundle_section(pair)}).with_view_arrays(distortion, None)
    above_dark = _above_dark(known, pair)
    gain_map = measure_gain_map(HotPixels(draft.calibration.background).mended(pair.image), above_dark)
    known, above_dark = (each.with_view_arrays(distortion, gain_map) for each in (known, above_dark))
    if draft.bundle_um is not None:
        known = known.with_optics(um_per_px=draft.bundle_um / pair.confocal.diameter_px)
    flat = measure_flat_field(pair.image[None], above_dark) if pair.shows_flat_field else None
    known = known.model_copy(update={"flat": flat, "quality": _quality(known, pair, flat)})
    if draft.offset is not None:
        known = apply_offset(draft.with_calibration(known), draft.offset)
    if draft.galvo is not None:
        known = apply_galvo(draft.with_calibration(known), draft.galvo)
    return known


def apply_lag(draft: Draft, lag: ScanLag) -> Calibration:
    """Return the draft's calibration with a scan lag, and the galvo's response and correction if a ramp was learned.

    Raises
    ------
    InputError
        If there is no galvo map.
    """
    known = draft.calibration
    if known.galvo is None:
        raise InputError("a scan's lag belongs to a galvo map", "measure the galvo map first")
    update: dict[str, float | None] = dict.fromkeys(_OF_SCAN)
    update |= {"lag_s": lag.lag_s, "lag_uncertainty_s": lag.uncertainty_s}
    if lag.ramp is not None:
        update |= {"rows_off": lag.ramp.off, "highest_rate_hz": lag.ramp.highest_rate_hz}
    correction = None
    if lag.ramp is not None and lag.ramp.correction is not None:
        update |= {"natural_hz": lag.ramp.response.natural_hz, "damping": lag.ramp.response.damping}
        correction = lag.ramp.correction.astype(np.float32)
    return known.with_galvo(**update).model_copy(update={"scan_correction": correction})


def apply_background(draft: Draft, background: Background) -> Calibration:
    """Return the draft's calibration with a background."""
    return draft.calibration.model_copy(update={"background": background.mean})


def apply_flat_field(draft: Draft, flat: Image) -> Calibration:
    """Return the draft's calibration with a flat field, and the quality of the bundle pair that it gives.

    It is left as it is if the light varies as a specimen's does.
    """
    if structure_of_flat_field(flat, draft.calibration) > MAX_STRUCTURE:
        return draft.calibration
    update: dict[str, Any] = {"flat": flat}
    if draft.pair is not None:
        update["quality"] = _quality(draft.calibration, draft.pair, flat)
    return draft.calibration.model_copy(update=update)


def structure_of_flat_field(flat: Image, calibration: Calibration) -> float:
    """Return how much the light of a flat field varies from place to place: :func:`structure_of_light`.

    Parameters
    ----------
    flat : numpy.ndarray
        (n, n) float32, of the confocal view.
    calibration : Calibration
        With the bundle section; where it has that of the frame, what lies beyond its edge is left out.
    """
    side, bundle = len(flat), calibration.measured_bundle
    inside = disc(side, bundle.diameter_px)
    if calibration.frame is not None:
        inside &= within_frame(crop_to_frame(bundle.confocal_centre, side), side, calibration.frame.shape)
    return structure_of_light(flat, inside)


def with_darkness(draft: Draft) -> Calibration:
    """Return the draft's calibration with a background: its own, or else the darkness around the bundle pair."""
    known = draft.calibration
    return known if known.background is not None or draft.pair is None else _above_dark(known, draft.pair)


def _in_laser_light(calibration: Calibration, pair: BundlePair, light: SweptLight) -> Calibration:
    """Return a calibration with the gain in the light of a sweep, used where it shows that of a located pair."""
    found = laser_gain(light, in_lamp_light(calibration, pair))
    if found is None:
        return calibration
    update = {"swept_gain": found[0]}
    if abs(found[0] / pair.alignment.gain - 1) < MAX_DISAGREEMENT:
        update |= {"residual_gain": found[0], "residual_gain_uncertainty": found[1]}
    return calibration.model_copy(update={"bundle": _bundle_section(pair).model_copy(update=update)})


def _with_swept_flat_field(calibration: Calibration, pair: BundlePair, light: SweptLight) -> Calibration:
    """Return a calibration with the flat field of a sweep, where its bundle pair gave none."""
    flat = swept_flat_field(light, calibration) if calibration.flat is None else None
    if flat is None or structure_of_flat_field(flat, calibration) > MAX_STRUCTURE:
        return calibration
    return calibration.model_copy(update={"flat": flat, "quality": _quality(calibration, pair, flat)})


def in_lamp_light(calibration: Calibration, pair: BundlePair) -> Calibration:
    """Return a calibration with the gain in the light of the lamp, in which its bundle pair was located."""
    return calibration.model_copy(update={"bundle": _bundle_section(pair)})


def _bundle_section(pair: BundlePair) -> BundleSection:
    top, bottom = (tuple(float(value) for value in row) for row in pair.alignment.residual_to_confocal)
    stretch = abs(top[0] * bottom[1] - top[1] * bottom[0])
    if not STRETCHES[0] < stretch < STRETCHES[1]:
        raise MeasurementError(
            f"the views' alignment changes areas by {stretch:.2g}, so these are no two images of one bundle",
            "is the probe lit from the far end?",
        )
    return BundleSection(
        confocal_centre=pair.confocal.centre,
        residual_centre=pair.residual.centre,
        diameter_px=pair.confocal.diameter_px,
        residual_to_confocal=((top[0], top[1], top[2]), (bottom[0], bottom[1], bottom[2])),
        residual_gain=pair.alignment.gain,
        residual_gain_uncertainty=float(np.hypot(pair.alignment.gain_uncertainty, LAMP_GAIN * pair.alignment.gain)),
        centre_uncertainty_px=pair.confocal.centre_uncertainty_px,
        diameter_uncertainty_px=pair.confocal.diameter_uncertainty_px,
        alignment_uncertainty_px=pair.alignment.uncertainty_px,
    )


def _above_dark(calibration: Calibration, pair: BundlePair) -> Calibration:
    """Return the calibration with the darkness of the pair's own image as background."""
    return calibration.model_copy(update={"background": darkness(pair.image, pair.discs)})


def _quality(calibration: Calibration, pair: BundlePair, flat: Image | None) -> QualitySection:
    """Estimate how well the two views cancel, before and after the core filter, above the darkness of the pair."""
    known = in_lamp_light(calibration, pair).model_copy(update={"flat": flat})
    errors = measure_alignment_errors(pair.image, known)
    return QualitySection(
        alignment_error=errors.before, alignment_error_filtered=errors.after, core_filter=errors.cores.value
    )
