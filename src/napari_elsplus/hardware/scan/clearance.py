"""Distance of the parking position from the bundle."""

from __future__ import annotations

from typing import TYPE_CHECKING

from napari_elsplus.errors import InputError
from napari_elsplus.hardware.scan.waveform import exposed_rows

if TYPE_CHECKING:
    from napari_elsplus.instrument.calibration import Calibration


def check_parking(volts: float, calibration: Calibration | None) -> None:
    """Refuse a parking voltage at which the line is on either image of the calibrated bundle.

    Parameters
    ----------
    volts : float
        Parking voltage.
    calibration : Calibration, optional
        Without galvo or bundle section there is nothing to check.

    Raises
    ------
    InputError
        With the row of the line, and the rows of the bundle.

    Examples
    --------
    >>> from napari_elsplus.instrument.calibration import Calibration
    >>> bundle = {"diameter_px": 464, "confocal_centre": [262, 330], "residual_centre": [250, 990],
    ...           "residual_to_confocal": [[1, 0, 12], [0, 1, -660]]}
    >>> galvo = {"volts_per_row": 0.00126, "volts_at_row_zero": -0.3, "r_squared": 1, "rms_rows": 0}
    >>> calibration = Calibration.parse({"bundle": bundle, "galvo": galvo})
    >>> check_parking(-0.7, calibration)
    >>> check_parking(0.0, calibration)
    Traceback (most recent call last):
    napari_elsplus.errors.InputError: the parking voltage 0 V puts the line on row 238 of the bundle (18 to 494): ...
    """
    if calibration is None or calibration.galvo is None or calibration.bundle is None:
        return
    galvo = calibration.galvo
    row = (volts - galvo.volts_at_row_zero) / galvo.volts_per_row
    first, last = exposed_rows(calibration.bundle)
    if first <= row <= last:
        where = f"row {row:.0f} of the bundle ({first:.0f} to {last:.0f})"
        raise InputError(
            f"the parking voltage {volts:.4g} V puts the line on {where}",
            "choose park_v 100 um or more off the bundle, in the rig's file or the calibration",
        )
