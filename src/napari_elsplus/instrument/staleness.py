"""Settings of the rig by whose change sections of a calibration become stale."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from napari_elsplus.instrument.calibration import AcquiredWith, Calibration, FrameSection

_SETTING_WORDS: Final = {
    "slit_rows": ("slit", " rows"),
    "frame_rate_hz": ("frame rate", " Hz"),
    "gain_db": ("gain", " dB"),
}
"""Name and unit of the numbers of :class:`AcquiredWith`."""


def changed_setting(name: str, then: AcquiredWith | None, now: AcquiredWith) -> str:
    """Return the change of a setting in words; empty where it is the same, or not known of both.

    Parameters
    ----------
    name : str
        Field of :class:`AcquiredWith`.
    then, now : AcquiredWith
        Settings of a calibration, and of the rig.

    Examples
    --------
    >>> from napari_elsplus.instrument.calibration import AcquiredWith
    >>> then = AcquiredWith(slit_rows=3, objective="10x")
    >>> changed_setting("slit_rows", then, AcquiredWith(slit_rows=60))
    'slit changed from 3 to 60 rows'
    >>> changed_setting("objective", then, AcquiredWith(objective="10x", slit_rows=60))
    ''
    """
    values = getattr(then, name, None), getattr(now, name)
    if None in values or values[0] == values[1]:
        return ""
    words, unit = _SETTING_WORDS.get(name, (name, ""))
    before, after = (f"{value:g}" if isinstance(value, int | float) else str(value) for value in values)
    return f"{words} changed from {before} to {after}{unit}"


def stale_sections(
    calibration: Calibration, settings: AcquiredWith, frame: FrameSection | None = None
) -> dict[str, str]:
    """Return the sections of a calibration that no longer hold when the rig runs with other settings.

    Parameters
    ----------
    calibration : Calibration
        With the settings that it was acquired with.
    settings : AcquiredWith
        Current settings of the rig; None in a field: not compared.
    frame : FrameSection, optional
        Current recorded region.

    Returns
    -------
    dict of str to str
        Reason by the name of the section, `background` or `scan_correction`.
    """
    stale: dict[str, str] = {}
    if frame is not None and calibration.frame is not None and frame.shape != calibration.frame.shape:
        reason = f"frame {calibration.frame.shape} became {frame.shape}"
        stale |= dict.fromkeys(("offset", "galvo", "bundle", "background", "scan_correction"), reason)
    affected = {
        "objective": ("offset", "galvo", "bundle", "optics", "background", "scan_correction"),
        "slit_rows": ("background",),
        "gain_db": ("background",),
        "frame_rate_hz": ("optics", "scan_correction"),
    }
    for name, sections in affected.items():
        if change := changed_setting(name, calibration.acquired_with, settings):
            stale |= dict.fromkeys(sections, change)
    return {name: reason for name, reason in stale.items() if getattr(calibration, name) is not None}
