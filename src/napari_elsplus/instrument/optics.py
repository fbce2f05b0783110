"""The instrument in numbers: pixel, magnification, line period; rows <-> micrometres <-> seconds.

The rolling shutter makes rows the natural unit of everything: an exposure of N line periods is a slit of N rows, the
offset between the two views is a number of rows, and rows are time. Thrapp and Hughes, Methods; their eq. (2)
multiplies by the magnification where it must divide: slit width at the bundle = pixel pitch x rows / M.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from typing import Final

from napari_elsplus.errors import InputError

PIXEL_PITCH_UM: Final = 3.63
"""Pixel pitch of the FL3-U3-13S2M's sensor."""
SENSOR_SHAPE: Final = (1048, 1328)
"""Rows and columns of the sensor."""
LINE_RATE_HZ: Final = 130_750.6
"""Rows read per second, from the authors' later code; the paper's 7.63 us is the same, rounded."""
BUNDLE_UM: Final = 620.0
"""Diameter of the imaged part of the FIGH-30-650S."""
CORE_PITCH_UM: Final = 3.2
"""Mean spacing of the bundle's cores."""


@dataclass(frozen=True, slots=True)
class Optics:
    """Scale and timing of one set-up.

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
        """Seconds from one frame to the next."""
        return self.line_periods_per_frame * self.line_period_s

    @property
    def frame_rate_hz(self) -> float:
        """Frames per second."""
        return 1 / self.frame_period_s

    def um(self, rows: float) -> float:
        """Micrometres at the bundle spanned by a number of camera rows (or columns)."""
        return rows * self.um_per_px

    def rows(self, um: float) -> float:
        """Camera rows spanned by a length at the bundle."""
        return um / self.um_per_px

    def exposure_s(self, slit_rows: float) -> float:
        """Exposure that makes a slit of so many rows: eq. (1) of the paper."""
        return slit_rows * self.line_period_s

    def at_rate(self, rate_hz: float) -> Optics:
        """Return the same optics at another frame rate: the line period stays, the idle time grows."""
        return Optics(self.um_per_px, self.line_period_s, 1 / (rate_hz * self.line_period_s))


@dataclass(frozen=True, slots=True)
class Preset:
    """A way to run the camera: region, objective, highest frame rate.

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
"""The paper's two modes: all rows through the 10x objective; half of them through the 4x, 2.4 pixels per core."""


def preset(name: str) -> Preset:
    """Return the preset of that name.

    Raises
    ------
    InputError
        If there is none.
    """
    try:
        return PRESETS[name]
    except KeyError:
        raise InputError(f"there is no preset {name!r}", f"choose one of {', '.join(PRESETS)}") from None
