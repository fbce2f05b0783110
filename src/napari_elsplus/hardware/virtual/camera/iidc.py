"""Registers of the virtual Flea3: IIDC 1.32 command registers, as the maker's public reference lists them.

Bits are counted from the least significant one; IIDC's text counts from the other end.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Final

from napari_elsplus.hardware.virtual.camera.memory import Register, number, real
from napari_elsplus.hardware.virtual.camera.sensor import SensorModel
from napari_elsplus.hardware.virtual.camera.standard import INVALID_PARAMETER, Refusal

if TYPE_CHECKING:
    from collections.abc import Callable

    from napari_elsplus.hardware.virtual.camera.sensor import Sensor

SPACE: Final = 0xFFFF_F000_0000
"""Base of the IIDC register space; offsets of other blocks are given relative to it in quadlets."""
COMMANDS: Final = 0xFFFF_F0F0_0000
"""Base of the command registers."""
STROBES: Final = 0xFFFF_F0F0_5000
"""Strobe registers; chosen, register 48Ch points to them."""
ON, AUTOMATIC, PRESENT = 1 << 25, 1 << 24, 1 << 31
"""Bits of a feature's control register: on, automatic, implemented."""


@dataclass
class Pins:
    """General purpose pins: mode (3: strobe output), strobe switch, and delay in ticks of 1.024 MHz."""

    mode: list[int] = field(default_factory=lambda: [0] * 4)
    strobe: list[int] = field(default_factory=lambda: [0] * 4)
    times: list[int] = field(default_factory=lambda: [0] * 4)


class Flea3Registers:
    """Registers of a Flea3 FL3-U3-13S2M; see `napari_elsplus.hardware.virtual.camera.device.Make`.

    Parameters
    ----------
    sensor : Sensor
        Settings that they change.
    acquire : callable
        Called with True to start acquisition, with False to end it.
    """

    name: ClassVar = "virtual FL3-U3-13S2M"
    model: ClassVar = SensorModel()

    def __init__(self, sensor: Sensor, acquire: Callable[[bool], None]) -> None:
        self._sensor, self._acquire, self._acquiring = sensor, acquire, False
        self.pins = Pins()
        self.line_frequency = round(sensor.model.line_rate_hz)
        """Content of the register of the line frequency."""

    def strobe_delay_s(self, line: int) -> float | None:
        """Seconds from the beginning of the exposure to the edge on a `line`; None: there is none."""
        on = self.pins.mode[line] >> 16 & 0xF == 3 and self.pins.strobe[line] >> 20 & 1
        return (self.pins.times[line] >> 16) / 1.024e6 if on else None

    def registers(self) -> dict[int, Register]:
        """Return the registers by their addresses."""
        sensor, pins = self._sensor, self.pins
        offsets = {
            0x48C: number(lambda: (STROBES - SPACE) // 4),
            0x604: number(lambda: sensor.settings.binning - 1 << 29, self._mode),
            0x624: number(lambda: 0, self._load),
            0x818: self._switch("gamma"),
            0x81C: self._automatic("exposure"),
            0x820: self._automatic("gain"),
            0x830: self._switch("trigger"),
            0x83C: self._automatic("rate", "rate_limited"),
            0x910: real(lambda: 1e-6),
            0x914: real(lambda: sensor.max_exposure_s),
            0x918: real(lambda: sensor.settings.exposure_s, sensor.set_exposure),
            0x920: real(lambda: 0.0),
            0x924: real(lambda: 24.0),
            0x928: real(lambda: sensor.settings.gain_db, sensor.set_gain),
            0x960: real(lambda: 1.0),
            0x964: real(lambda: sensor.max_rate_hz),
            0x968: real(lambda: sensor.rate_hz, sensor.set_rate),
            0xA00: number(lambda: sensor.shape[1] << 16 | sensor.shape[0]),
            0xA04: number(lambda: sensor.model.size_step[1] << 16 | sensor.model.size_step[0]),
            0xA08: number(
                lambda: sensor.settings.col << 16 | sensor.settings.row,
                lambda word: sensor.set_region(col=word >> 16, row=word & 0xFFFF),
            ),
            0xA0C: number(
                lambda: sensor.settings.cols << 16 | sensor.settings.rows,
                lambda word: sensor.set_region(cols=word >> 16, rows=word & 0xFFFF),
            ),
            0x12F8: number(
                lambda: PRESENT | sensor.settings.frame_info,
                lambda word: sensor.set_format(frame_info=word & 0x3FF),
            ),
            0x1AF4: number(lambda: self.line_frequency),
            0x4030: number(lambda: self._acquiring << 31, self._run),
            0x4070: number(lambda: 0, self._coding),
            0x5410: number(lambda: sensor.settings.rows * sensor.settings.cols),
        }
        registers = {COMMANDS + offset: register for offset, register in offsets.items()}
        for line in range(4):
            registers[COMMANDS + 0x1110 + 0x10 * line] = _item(pins.mode, line)
            registers[STROBES + 0x300 + 4 * line] = _item(pins.strobe, line)
            registers[STROBES + 0x400 + 4 * line] = _item(pins.times, line)
        return registers

    def _switch(self, name: str) -> Register:
        """Control register of a feature that is on or off."""
        sensor = self._sensor
        return number(
            lambda: PRESENT | (ON if getattr(sensor.settings, name) else 0),
            lambda word: setattr(sensor.settings, name, bool(word & ON)),
        )

    def _automatic(self, name: str, limit: str = "") -> Register:
        """Control register of a feature that the camera may choose by itself."""
        sensor = self._sensor

        def put(word: int) -> None:
            sensor.set_automatic(name, bool(word & AUTOMATIC))
            if limit:
                setattr(sensor.settings, limit, bool(word & ON))

        def get() -> int:
            on = not limit or getattr(sensor.settings, limit)
            return PRESENT | (ON if on else 0) | (AUTOMATIC if name in sensor.settings.automatic else 0)

        return number(get, put)

    def _mode(self, word: int) -> None:
        self._sensor.set_format(binning=(word >> 29) + 1)

    def _load(self, word: int) -> None:
        if word:
            raise Refusal(INVALID_PARAMETER)  # only the default settings are stored
        self._sensor.reset()
        pins = Pins()
        self.pins.mode[:], self.pins.strobe[:], self.pins.times[:] = pins.mode, pins.strobe, pins.times

    def _run(self, word: int) -> None:
        self._acquire(bool(word >> 31))
        self._acquiring = bool(word >> 31)

    def _coding(self, word: int) -> None:
        if word:
            raise Refusal(INVALID_PARAMETER)  # Mono8 only


def _item(words: list[Any], index: int) -> Register:
    """Register of one word of a list."""
    return number(lambda: words[index], lambda word: words.__setitem__(index, word))
