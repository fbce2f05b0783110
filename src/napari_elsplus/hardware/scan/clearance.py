"""Distance of the parking position from the bundle.

Demanded of a parking position: off the lit bundle by the width of its halo, outside of the rows that the line sweeps
while they are exposed, and within the rig's limits. The flyback may pass it: nothing is exposed then, and a line that
moves on leaves no light there.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from napari_elsplus.errors import InputError
from napari_elsplus.hardware.scan.waveform import exposed_rows
from napari_elsplus.instrument.optics import HALO_UM, PARK_CLEARANCE_UM

if TYPE_CHECKING:
    from napari_elsplus.hardware.scan.waveform import GalvoLimits, Waveform
    from napari_elsplus.instrument.calibration import BundleSection, Calibration, GalvoSection

ROUNDING_UM: Final = 1e-3
"""Micrometres by which a position may fall short, as numbers are rounded; chosen: a part in 1e5 of the halo's width."""


def check_parking(volts: float, calibration: Calibration | None, limits: GalvoLimits) -> None:
    """Refuse a parking voltage at which the line is on the calibrated bundle, or closer to it than its halo is wide.

    Parameters
    ----------
    volts : float
        Parking voltage.
    calibration : Calibration, optional
        Without galvo or bundle section there is nothing to check; without micrometres per pixel the rows that are
        exposed alone are refused.
    limits : GalvoLimits
        Range of the voltage that the message names.

    Raises
    ------
    InputError
        With the row of the line, the rows that it has to be off, and a parking voltage that would do.

    Examples
    --------
    >>> from napari_elsplus.hardware.scan.waveform import GalvoLimits
    >>> from napari_elsplus.instrument.calibration import Calibration
    >>> bundle = {"diameter_px": 464, "confocal_centre": [262, 330], "residual_centre": [250, 990],
    ...           "residual_to_confocal": [[1, 0, 12], [0, 1, -660]]}
    >>> galvo = {"volts_per_row": 0.00126, "volts_at_row_zero": -0.3, "r_squared": 1, "rms_rows": 0}
    >>> calibration = Calibration.parse({"bundle": bundle, "galvo": galvo, "optics": {"um_per_px": 1.33}})
    >>> check_parking(-0.7, calibration, GalvoLimits())
    >>> check_parking(0.0, calibration, GalvoLimits())
    Traceback (most recent call last):
    napari_elsplus.errors.InputError: the parking voltage 0 V puts the line on row 238, on the bundle (18 to 494): ...
    """
    if calibration is None or calibration.galvo is None or calibration.bundle is None:
        return
    galvo, bundle = calibration.galvo, calibration.bundle
    um_per_px = calibration.optics.um_per_px if calibration.optics is not None else None
    first, last = exposed_rows(bundle)
    low, high = _kept_clear(bundle, HALO_UM - ROUNDING_UM, um_per_px)
    row = (volts - galvo.volts_at_row_zero) / galvo.volts_per_row
    if not low <= row <= high:
        return
    on_bundle = first <= row <= last
    where = f"on the bundle ({first:.0f} to {last:.0f})" if on_bundle else f"within {HALO_UM:g} um of the bundle's rim"
    raise InputError(
        f"the parking voltage {volts:.4g} V puts the line on row {row:.0f}, {where}",
        _remedy(galvo, _kept_clear(bundle, PARK_CLEARANCE_UM, um_per_px), limits),
    )


def check_parking_while_scanning(volts: float, waveform: Waveform | None) -> None:
    """Refuse a parking voltage among those at which a scan exposes rows.

    Parameters
    ----------
    volts : float
        Parking voltage.
    waveform : Waveform, optional
        The scan; without one there is nothing to check.

    Raises
    ------
    InputError
        With the voltages of the scan.
    """
    if waveform is None or waveform.exposed_v is None:
        return
    low, high = waveform.exposed_v
    if low <= volts <= high:
        raise InputError(
            f"the parking voltage {volts:.4g} V is on the bundle, scanned from {low:.4g} to {high:.4g} V",
            "choose park_v off the bundle, in the rig's file or the calibration",
        )


def _kept_clear(bundle: BundleSection, clearance_um: float, um_per_px: float | None) -> tuple[float, float]:
    """Return the first and last row to keep clear: those exposed, and the lit bundle with a margin around it."""
    first, last = exposed_rows(bundle)
    lit = bundle.diameter_px / 2 + (0.0 if um_per_px is None else clearance_um / um_per_px)
    centre = bundle.confocal_centre[0]
    return min(first, centre - lit), max(last, centre + lit)


def _remedy(galvo: GalvoSection, kept_clear: tuple[float, float], limits: GalvoLimits) -> str:
    """Return what to do: the voltage nearest to zero that clears the rows, if the limits allow one."""
    rows = kept_clear[0] - 1, kept_clear[1] + 1
    volts = [round(galvo.volts_at_row_zero + galvo.volts_per_row * row, 4) for row in rows]
    within = [one for one in volts if limits.min_v <= one <= limits.max_v]
    if not within:
        return (
            f"no voltage within {limits.min_v:g} to {limits.max_v:g} V clears it: set min_v or max_v of the rig's file "
            f"to reach {min(volts, key=abs):.4g} V, if the galvo may go there"
        )
    return f"park_v = {min(within, key=abs):.4g} would do, in the rig's file or the calibration"
