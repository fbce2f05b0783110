"""Warnings and remedies of an axial response in words: contact, bleaching, uncertain drop-off distances."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from napari_elsplus.processing.axial.axial_response import ASSUMED_LOSS, MAX_CHANCE, MAX_UNCERTAINTY
from napari_elsplus.processing.axial.bleaching import MIN_FREEDOM

if TYPE_CHECKING:
    from napari_elsplus.processing.axial.axial_response import AxialResponse

MAX_FRAMES_ADVISED: Final = 100
"""Multiple of the frames beyond which the cause of their scatter is to be removed instead; chosen: a scan of a minute
would take hours."""
MAX_DISPLACED: Final = 0.02
"""Displacement of the plate between frames of one depth, part of the ELS+ 3 dB distance, from which it is noted;
chosen: half of it is an error by `MAX_UNCERTAINTY`."""


def axial_notes(response: AxialResponse) -> list[str]:
    """Return what restricts the distances of an axial response, a line each, with the remedy.

    Parameters
    ----------
    response : AxialResponse
        Of a scan.

    Returns
    -------
    list of str
        Lines that are warnings begin with "warning: ".
    """
    notes = (
        _black_level_note(response),
        _contact_note(response),
        _rise_note(response),
        _beat_note(response),
        _bleaching_note(response),
        _displacement_note(response),
        _tilt_note(response),
        uncertainty_note(response),
    )
    return [line for line in notes if line]


def axial_content(response: AxialResponse) -> dict[str, Any]:
    """Return the results of an axial response, and as `notes` what restricts them, ready for JSON.

    Parameters
    ----------
    response : AxialResponse
        Of a scan.
    """
    return {**response.content(), "notes": axial_notes(response)}


def _black_level_note(response: AxialResponse) -> str:
    black = response.black
    if black is None or (black.background and not black.dn):
        return ""
    if black.background:
        return (
            f"warning: the black level changed by {black.dn:+.2g} grey levels since the background was recorded:"
            " corrected; record the background again"
        )
    if not black.known:
        return (
            "warning: the calibration has no background, and the frames have no dark pixels beside the views: the"
            " distances contain the black level; calibrate with a background"
        )
    return (
        f"warning: the calibration has no background: the level beside the views, {black.dn:.3g} grey levels, was"
        " subtracted, the bundle's own light was not; calibrate with a background"
    )


def _contact_note(response: AxialResponse) -> str:
    if response.pressed:
        first_um = response.depth_um[0]
        return (
            f"warning: the signals do not change from {first_um:g} to {first_um + response.level_um:.3g} um, as those"
            f" of a plate that is pressed: contact was taken to be {response.contact_um:g} um: count the depths from"
            " contact"
        )
    if not response.contact_assumed:
        return ""
    return (
        f"contact was taken to be the first depth, {response.contact_um:g} um, not seen: begin the scan before contact,"
        " or count the depths from it"
    )


def _rise_note(response: AxialResponse) -> str:
    rise = response.rise
    if rise is None:
        return ""
    return (
        f"warning: the signal rises again beyond contact, from {rise.from_um:g} to {rise.to_um:g} um: distances beyond"
        " are not those of one plane: use a plate with nothing behind it, in light that does not change"
    )


def _beat_note(response: AxialResponse) -> str:
    beat = response.beat
    if beat is None:
        return ""
    varies = f"warning: the light varies by +- {100 * beat.share:.1f} % every {beat.period_frames:.3g} frames"
    if beat.slower:
        return (
            f"{varies}, or more slowly and by more: corrected by their mean, and the uncertainties contain both:"
            " record there and back in steady light, or at another frame rate"
        )
    return f"{varies}, as that of a lamp beats with the frame rate: corrected; use steady light, or another frame rate"


def _bleaching_note(response: AxialResponse) -> str:
    if response.loss is None:
        level = "10 dB" if np.isfinite(response.els_10db.um) else "3 dB"
        return (
            f"warning: fewer than {MIN_FREEDOM + 1} frames repeat a depth: bleaching and slow beats of the light are"
            " not seen, and the uncertainties do not contain them; if"
            f" {100 * ASSUMED_LOSS:.0f} % of the light was lost in the scan, ELS+ {level} lies"
            f" {response.unseen_um:.1f} um farther: record the scan there and back"
        )
    if not response.loss.significant:
        return ""
    lost, sigma = 100 * response.loss.share, 100 * response.loss.share_uncertainty
    return f"warning: the light fell by {lost:.1f} +- {sigma:.1f} % in the course of the scan: corrected"


def _displacement_note(response: AxialResponse) -> str:
    if not response.displaced_um > MAX_DISPLACED * response.els_3db.um:
        return ""
    return (
        f"warning: frames of one depth differ as if the plate had moved by {response.displaced_um:.2g} um in between,"
        " by backlash of the stage or drift of the focus: approach each depth from the same side, when nothing drifts"
    )


def _tilt_note(response: AxialResponse) -> str:
    tilt = response.tilt
    if tilt is None or response.gap_share <= MAX_UNCERTAINTY:
        return ""
    return (
        f"warning: the plate is tilted by {tilt.degrees:.2g} +- {tilt.uncertainty_deg:.1g} degrees, or uneven: where"
        f" the bundle's rim touches it, {tilt.gap_um:.2g} um are left in the middle, and distances differ by up to"
        f" {100 * response.gap_share:.0f} %: level the plate"
    )


def uncertainty_note(response: AxialResponse) -> str:
    """Return the warning that ELS+ distances are uncertain, with the remedy; empty if they are not.

    Parameters
    ----------
    response : AxialResponse
        Of a scan.
    """
    advised, least = response.frames_advised, response.least_certain
    if advised == 1 and response.uncertainty <= MAX_UNCERTAINTY:
        return ""
    remedy = "calibrate with a sweep of more voltages: the residual view's gain is uncertain"
    contact_um = least.per_contact * response.contact_uncertainty_um
    gap_um = 0.0 if response.tilt is None else least.per_gap * response.tilt.gap_um
    # Between depths far apart the bend of the curve counts as scatter, too: finer steps reduce both.
    if least.uncertainty_um**2 < 2 * gap_um**2:
        remedy = "level the plate"
    elif response.contact_uncertainty_um**2 < 2 * (response.displaced_um / 2) ** 2 and contact_um > least.random_um:
        remedy = "approach each depth from the same side"
    elif least.uncertainty_um**2 < 2 * contact_um**2:
        remedy = "contact lies between two depths: record at finer steps about it"
    elif least.sampling_um > (0.0 if advised <= MAX_FRAMES_ADVISED else least.random_um):
        depths = f"{least.depths} {'depth' if least.depths == 1 else 'depths'}"
        level = "3 dB" if least is response.els_3db else "10 dB"
        remedy = f"{depths} near the {level} point: record at steps of at most {least.max_step_um:.2g} um there"
    elif advised == 1 and response.chance > MAX_CHANCE:
        remedy = "more frames would not help, the plate has bleached: lower the laser's power, or take a fresh plate"
    elif advised > MAX_FRAMES_ADVISED:
        remedy = "more frames would not help: the line jitters or the light varies from frame to frame"
    elif advised > 1:
        remedy = f"record {advised} times as many frames at each depth"
    return f"warning: ELS+ distances are uncertain by {100 * response.uncertainty:.1f} %: {remedy}"
