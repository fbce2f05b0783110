"""Registers of the Flea3 FL3-U3-13S2M: USB3 Vision around IIDC registers.

Addresses are from the maker's public register reference and the authors' code; no camera has confirmed them yet, see
docs/first-light.md.
"""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING, Final

from napari_elsplus.errors import DeviceError, InputError
from napari_elsplus.hardware.limits import SensorLimits
from napari_elsplus.hardware.u3v.control import RegisterError
from napari_elsplus.instrument.optics import LINE_RATE_HZ

if TYPE_CHECKING:
    from napari_elsplus.hardware.protocols import Region
    from napari_elsplus.hardware.u3v.control import Control

IIDC: Final = 0xFFFF_F000_0000
"""Base of the IIDC register space; strobe registers are given relative to it."""
BASE: Final = 0xFFFF_F0F0_0000
"""Address of the camera's command registers; all below are relative to it."""
STROBE_OFFSET, VIDEO_MODE, MEMORY_CHANNEL = 0x48C, 0x604, 0x624
FRAME_RATE_MODE, EXPOSURE_MODE, GAIN_MODE, GAMMA_MODE, TRIGGER_MODE = 0x83C, 0x81C, 0x820, 0x818, 0x830
EXPOSURE_MIN, EXPOSURE_MAX, EXPOSURE = 0x910, 0x914, 0x918
GAIN_MIN, GAIN_MAX, GAIN = 0x920, 0x924, 0x928
RATE_MIN, RATE_MAX, RATE = 0x960, 0x964, 0x968
MAX_SIZE, UNIT_SIZE, OFFSET, SIZE = 0xA00, 0xA04, 0xA08, 0xA0C
GPIO_MODE, FRAME_INFO, LINE_FREQUENCY, ACQUISITION, PIXEL_CODING = 0x1110, 0x12F8, 0x1AF4, 0x4030, 0x4070
STROBE_CONTROL, STROBE_TIMES = 0x300, 0x400
"""Offsets from the strobe block: on, polarity; delay, duration."""
AUTO, ON, ACQUIRE, STROBE_ON, GPIO_STROBE = 1 << 24, 1 << 25, 1 << 31, 1 << 20, 3 << 16
"""Bits of the registers above."""
LEFT_ON: Final = {
    "gamma": (GAMMA_MODE, ON),
    "an external trigger": (TRIGGER_MODE, ON),
    "binning": (VIDEO_MODE, 7 << 29),
    "numbers in the first pixels of the image": (FRAME_INFO, 0x3FF),
}
"""Features that other programs may leave on and that change the images: register, and bits that have to be 0."""
UNIT_PX: Final = (2, 4)
"""Rows and columns in which the region moves; the sizes' unit is read from the camera."""


class Flea3:
    """Features of the Flea3; see `napari_elsplus.hardware.u3v.camera.Features`.

    Parameters
    ----------
    control : Control
        Control channel of the camera.
    line_rate_hz : float
        Rows per second, used where the camera's own register holds no plausible rate.
    strobe_line : int
        GPIO that carries the strobe.
    """

    def __init__(self, control: Control, *, line_rate_hz: float = LINE_RATE_HZ, strobe_line: int = 1) -> None:
        self._control, self._strobe_line = control, strobe_line
        self._line_rate_hz = self._reported_line_rate(line_rate_hz)

    @property
    def line_period_s(self) -> float:
        """Seconds per row."""
        return 1 / self._line_rate_hz

    @property
    def frame_rate_hz(self) -> float:
        """Frame rate that the camera reports, in Hz."""
        return self._control.read_float(BASE + RATE)

    @property
    def sensor(self) -> SensorLimits:
        """Size of the sensor, and its steps."""
        control = self._control
        size, step = _halves(control.read_number(BASE + MAX_SIZE)), _halves(control.read_number(BASE + UNIT_SIZE))
        return SensorLimits(*size, *step, *UNIT_PX)

    @property
    def frame_rate_limits_hz(self) -> tuple[float, float]:
        """Lowest and highest frame rate, in Hz."""
        return self._control.read_float(BASE + RATE_MIN), self._control.read_float(BASE + RATE_MAX)

    def configure(self, region: Region, exposure_s: float, frame_rate_hz: float, gain_db: float) -> None:
        """Set the camera; see :meth:`napari_elsplus.hardware.u3v.camera.Features.configure`."""
        self._set_region(region)
        control = self._control
        control.write_number(BASE + PIXEL_CODING, 0)
        for mode in (FRAME_RATE_MODE, EXPOSURE_MODE, GAIN_MODE):
            held = control.read_number(BASE + mode) & ~AUTO
            control.write_number(BASE + mode, held | ON)
        control.write_float(BASE + EXPOSURE, control.read_float(BASE + EXPOSURE_MIN))  # a long one limits the rate
        self._set("frame rate", "Hz", RATE_MIN, RATE_MAX, RATE, frame_rate_hz)
        self._set("exposure", "s", EXPOSURE_MIN, EXPOSURE_MAX, EXPOSURE, exposure_s)
        self._set("gain", "dB", GAIN_MIN, GAIN_MAX, GAIN, gain_db)
        control.write_number(BASE + GPIO_MODE + 0x10 * self._strobe_line, GPIO_STROBE)
        strobe = IIDC + 4 * control.read_number(BASE + STROBE_OFFSET) + 4 * self._strobe_line
        control.write_number(strobe + STROBE_TIMES, 0)  # no delay, as long as the exposure
        control.write_number(strobe + STROBE_CONTROL, STROBE_ON)

    def reset(self) -> None:
        """Load the default settings; see :meth:`napari_elsplus.hardware.u3v.camera.Features.reset`."""
        control = self._control
        with contextlib.suppress(RegisterError):  # firmware without memory channels
            control.write_number(BASE + MEMORY_CHANNEL, 0)
        for name, (register, bits) in LEFT_ON.items():
            try:
                held = control.read_number(BASE + register)
                if held & bits:
                    control.write_number(BASE + register, held & ~bits)
                    held = control.read_number(BASE + register)
            except RegisterError:
                continue  # a camera without that feature
            if held & bits:
                raise DeviceError(f"the camera keeps {name} switched on", "switch it off with the maker's software")

    def start(self) -> None:
        """Begin to acquire."""
        self._control.write_number(BASE + ACQUISITION, ACQUIRE)

    def stop(self) -> None:
        """End acquiring."""
        self._control.write_number(BASE + ACQUISITION, 0)

    def _set_region(self, region: Region) -> None:
        control = self._control
        sensor = self.sensor
        tall, wide, unit_rows, unit_cols = sensor.rows, sensor.cols, sensor.row_step, sensor.col_step
        step_rows, step_cols = UNIT_PX
        if region.row + region.rows > tall or region.col + region.cols > wide:
            raise InputError(
                f"a region of {region.rows} x {region.cols} at {region.row}, {region.col}",
                f"the camera's sensor has {tall} x {wide} pixels",
            )
        uneven = region.rows % unit_rows or region.cols % unit_cols or region.row % step_rows or region.col % step_cols
        if uneven:
            raise InputError(
                f"a region of {region.rows} x {region.cols} at {region.row}, {region.col}",
                f"the camera's sizes go in steps of {unit_rows} x {unit_cols}, its origin in {step_rows} x {step_cols}",
            )
        control.write_number(BASE + OFFSET, 0)  # the new size must fit where the old origin was
        control.write_number(BASE + SIZE, region.cols << 16 | region.rows)
        control.write_number(BASE + OFFSET, region.col << 16 | region.row)

    def _set(self, name: str, unit: str, low: int, high: int, register: int, value: float) -> None:
        control = self._control
        least, most = control.read_float(BASE + low), control.read_float(BASE + high)
        if not least * (1 - 1e-4) <= value <= most * (1 + 1e-4):
            raise InputError(f"{name} of {value:.6g} {unit}", f"the camera allows {least:.6g} to {most:.6g} {unit}")
        control.write_float(BASE + register, value)

    def _reported_line_rate(self, expected_hz: float) -> float:
        """Return the line rate of the camera's register if it is within 5 % of the one expected, else that one."""
        try:
            reported = float(self._control.read_number(BASE + LINE_FREQUENCY))
        except RegisterError:
            return expected_hz
        return reported if abs(reported / expected_hz - 1) < 0.05 else expected_hz


def _halves(word: int) -> tuple[int, int]:
    """Return rows and columns of a register that holds columns in its upper half, rows in its lower one."""
    return word & 0xFFFF or 1, word >> 16 or 1
