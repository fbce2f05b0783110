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
