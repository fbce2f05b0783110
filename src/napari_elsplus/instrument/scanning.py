"""What a calibration lacks for a scan that is on the slit."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from napari_elsplus.instrument.calibration import Calibration


def lag_advice(calibration: Calibration | None) -> str:
    """Return a warning if the scan lag of a calibration was not measured; else an empty string.

    Parameters
    ----------
    calibration : Calibration or None
        The active calibration.
    """
    if calibration is None or calibration.galvo is None or calibration.galvo.lag_s is not None:
        return ""
    return "scan lag not measured: the image is off the slit"


def rate_advice(calibration: Calibration | None) -> str:
    """Return a warning if rows miss the slit in the scan of a calibration; else an empty string.

    Parameters
    ----------
    calibration : Calibration or None
        The active calibration.

    Examples
    --------
    >>> from napari_elsplus.instrument.calibration import Calibration, GalvoSection
    >>> galvo = GalvoSection(volts_per_row=1e-3, volts_at_row_zero=0, r_squared=1, rms_rows=0, rows_off=451)
    >>> rate_advice(Calibration(galvo=galvo))
    '451 rows miss the slit: choose a lower frame rate, and measure the scan lag at it'
    """
    galvo = None if calibration is None else calibration.galvo
    if galvo is None or not galvo.rows_off:
        return ""
    rate_hz, miss = galvo.highest_rate_hz, f"{galvo.rows_off} rows miss the slit"
    if rate_hz is None:
        return f"{miss}: choose a lower frame rate, and measure the scan lag at it"
    if not rate_hz:
        return f"{miss}, the galvo is too slow at every frame rate: check its limits in the rig's file"
    lower = f"choose {rate_hz:.0f} frames per second or fewer, and measure the scan lag at it"
    return f"{miss}, the galvo is too slow: {lower}"


def dark_advice(calibration: Calibration) -> str:
    """Return a warning if the galvo stays parked by a calibration, which lacks what a scan needs; else an empty string.

    Parameters
    ----------
    calibration : Calibration
        The active calibration.
    """
    sections = {"galvo map": calibration.galvo, "bundle": calibration.bundle}
    lacking = " and no ".join(words for words, section in sections.items() if section is None)
    return f"the galvo stayed parked and frames are dark: the calibration has no {lacking}" if lacking else ""
