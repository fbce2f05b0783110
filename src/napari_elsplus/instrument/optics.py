"""Optics and timing of the instrument: conversion between rows, micrometres and seconds; the paper's presets.

Rows are the natural unit of a rolling shutter: an exposure of N line periods is a slit of N rows, the
offset between the two views is a number of rows, and rows are time. Thrapp and Hughes, Methods; their eq. (2)
multiplies by the magnification where it must divide: slit width at the bundle = pixel pitch x rows / M.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from typing import Final

from napari_elsplus.errors import InputError

PIXEL_PITCH_UM: Final = 3.63
"""Pixel pitch of the sensor, micrometres (data sheet of the FL3-U3-13S2M)."""
SENSOR_SHAPE: Final = (1048, 1328)
"""Rows and columns of the sensor (data sheet of the FL3-U3-13S2M)."""
LINE_RATE_HZ: Final = 130_750.6
"""Rows read per second (the authors' later code); the paper's line period of 7.63 us is the same to 0.3 %."""
BUNDLE_UM: Final = 620.0
"""Diameter of the imaged part of the bundle FIGH-30-650S, micrometres (the paper)."""
MIN_BUNDLE_UM: Final = 50.0
MAX_BUNDLE_UM: Final = 10_000.0
"""Diameters that a bundle, or the field of view of its probe, can have; chosen: half of what the thinnest probes see,
and thrice the widest bundle. One in millimetres or nanometres lies beyond."""
CORE_PITCH_UM: Final = 3.2
"""Mean spacing of the bundle's cores, micrometres (the paper)."""
HALO_UM: Final = 100.0
"""Width of the halo around the lit bundle, micrometres: 2.6 standard deviations of that in the recordings (38.3 um)."""
PARK_CLEARANCE_UM: Final = 1.2 * HALO_UM
"""From the rim of the bundle to a parked line, micrometres; derived: the halo, and a fifth for the galvo's map beyond
the bundle."""


def require_bundle_um(bundle_um: float) -> None:
    """Refuse a diameter of the bundle in micrometres (`bundle_um`) that no bundle has.

    Raises
    ------
    InputError
        If it is not between :data:`MIN_BUNDLE_UM` and :data:`MAX_BUNDLE_UM`.

    Examples
    --------
    >>> require_bundle_um(0.62)
    Traceback (most recent call last):
        ...
    napari_elsplus.errors.InputError: a bundle of 0.62 um across: give its diameter in micrometres, 50 to 10000
    """
    if not MIN_BUNDLE_UM <= bundle_um <= MAX_BUNDLE_UM:
        raise InputError(
            f"a bundle of {bundle_um:g} um across",
            f"give its diameter in micrometres, {MIN_BUNDLE_UM:g} to {MAX_BUNDLE_UM:g}",
        )


@dataclass(frozen=True, slots=True)
class Optics:
    """Scale and timing of an optical set-up.

    Parameters
    ----------
    um_per_px : float
        Micrometres at the bundle's face for one camera pixel.
    line_period_s : float
        Seconds from the readout of one row to that of the next.
    line_periods_per_frame : float
        Line periods from one frame to the next, idle time included; not a whole number in general.

    Raises
    ------
    InputError
        If a number is not finite and positive.

    Examples
    --------
    >>> optics = Optics(um_per_px=0.9608, line_period_s=7.648e-6, line_periods_per_frame=1089.6)
    >>> round(optics.frame_rate_hz, 1)
    120.0
    >>> round(optics.rows(29.0), 1), round(optics.um(3), 2)
    (30.2, 2.88)
    """

    um_per_px: float
    line_period_s: float = 1 / LINE_RATE_HZ
    line_periods_per_frame: float = 1089.6

    def __post_init__(self) -> None:
        for name in self.__slots__:
            value = getattr(self, name)
            if not (isfinite(value) and value > 0):
                raise InputError(f"{name} is {value}", "it must be a positive number")

    @property
    def frame_period_s(self) -> float:
        """Frame period in seconds."""
        return self.line_periods_per_frame * self.line_period_s

    @property
    def frame_rate_hz(self) -> float:
        """Frame rate in frames per second."""
        return 1 / self.frame_period_s

    def um(self, rows: float) -> float:
        """Return the length in micrometres at the bundle that a number of camera rows (or columns) spans."""
        return rows * self.um_per_px

    def rows(self, um: float) -> float:
        """Return the number of camera rows that a length in micrometres (`um`) at the bundle spans."""
        return um / self.um_per_px

    def exposure_s(self, slit_rows: float) -> float:
        """Return the exposure in seconds that gives a slit of a width in rows (`slit_rows`): eq. (1) of the paper."""
        return slit_rows * self.line_period_s

    def at_rate(self, rate_hz: float) -> Optics:
        """Return the same optics at another frame rate in Hz: the line period stays, the idle time changes."""
        return Optics(self.um_per_px, self.line_period_s, 1 / (rate_hz * self.line_period_s))


@dataclass(frozen=True, slots=True)
class Preset:
    """Camera mode: region, objective, highest frame rate.

    Parameters
    ----------
    name : str
        ``"120hz"`` or ``"240hz"``.
    frame_shape : tuple of int
        Rows and columns of a raw frame.
    sensor_origin : tuple of int
        Row and column of the region's corner on the sensor.
    objective : str
        Objective between bundle and camera.
    optics : Optics
        Scale and timing at the preset's highest frame rate.
    """

    name: str
    frame_shape: tuple[int, int]
    sensor_origin: tuple[int, int]
    objective: str
    optics: Optics


PRESETS: Final = {
    "120hz": Preset(
        "120hz", SENSOR_SHAPE, (0, 0), "10x", Optics(PIXEL_PITCH_UM / 3.778, line_periods_per_frame=LINE_RATE_HZ / 120)
    ),
    "240hz": Preset(
        "240hz", (524, 1328), (262, 0), "4x", Optics(CORE_PITCH_UM / 2.4, line_periods_per_frame=LINE_RATE_HZ / 240)
    ),
}
"""The paper's two modes: 120 Hz, all rows, 10x objective (magnification 3.778); 240 Hz, half the rows, 4x objective
(2.4 pixels per core)."""


def preset(name: str) -> Preset:
    """Return the preset with a name.

    Raises
    ------
    InputError
        If no preset has that name.
    """
    try:
        return PRESETS[name]
    except KeyError:
        raise InputError(f"there is no preset {name!r}", f"choose one of {', '.join(PRESETS)}") from None
