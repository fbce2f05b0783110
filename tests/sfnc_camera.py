"""Registers of another virtual camera, of no maker: features of the Standard Features Naming Convention (SFNC).

What differs from the Flea3 and is common among cameras: another sensor and steps, ``TLParamsLocked`` has to be set
before it starts, an output that cannot be turned into an input, chunks, and selectors.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, Final

import camera_description as xml
from napari_elsplus.hardware.virtual.camera.memory import Register, number, real
from napari_elsplus.hardware.virtual.camera.sensor import SensorModel
from napari_elsplus.hardware.virtual.camera.standard import ACCESS_DENIED, INVALID_PARAMETER, Refusal

if TYPE_CHECKING:
    from collections.abc import Callable

    from napari_elsplus.hardware.virtual.camera.sensor import Sensor, Settings

AT: Final = 0x1000_0000
"""Address of the first register; chosen."""
LINES: Final = {"Line0": 0, "Line1": 1, "Line2": 2}
"""Lines: an input, a fixed output, and one that may be either."""
FIXED_OUTPUT: Final = 1


class StandardRegisters:
    """Registers by feature; see `napari_elsplus.hardware.virtual.camera.device.Make`.

    Parameters
    ----------
    sensor : Sensor
        Settings that they change.
    acquire : callable
        Called with True to start acquisition, with False to end it.
    """

    name: ClassVar = "virtual SFNC camera"
    model: ClassVar = SensorModel(
        shape=(960, 1280),
        size_step=(2, 8),
        origin_step=(2, 8),
        line_rate_hz=100_000.0,
        automatic=frozenset({"exposure", "gain"}),
    )

    def __init__(self, sensor: Sensor, acquire: Callable[[bool], None]) -> None:
        self._sensor, self._acquire = sensor, acquire
        self.parameters_locked = False
        self._line = 0
        self._sources, self._modes = [0, 0, 0], [0, 1, 0]

    def strobe_delay_s(self, line: int) -> float | None:
        """Seconds from the beginning of the exposure to the edge on a `line`; None: there is none."""
        return 0.0 if line < 3 and self._sources[line] and self._modes[line] else None

    def registers(self) -> dict[int, Register]:
        """Return the registers by their addresses."""
        sensor = self._sensor

        def settings() -> Settings:  # a reset replaces them
            return sensor.settings

        registers = {
            0x00: number(lambda: settings().cols, lambda value: sensor.set_region(cols=value)),
            0x04: number(lambda: settings().rows, lambda value: sensor.set_region(rows=value)),
            0x08: number(lambda: settings().col, lambda value: sensor.set_region(col=value)),
            0x0C: number(lambda: settings().row, lambda value: sensor.set_region(row=value)),
            0x10: number(lambda: sensor.shape[1] - settings().col),
            0x14: number(lambda: sensor.shape[0] - settings().row),
            0x18: number(lambda: sensor.shape[1] - settings().cols),
            0x1C: number(lambda: sensor.shape[0] - settings().rows),
            0x20: real(lambda: settings().exposure_s * 1e6, lambda value: sensor.set_exposure(value / 1e6)),
            0x24: real(lambda: 1.0),
            0x28: real(lambda: sensor.max_exposure_s * 1e6),
            0x30: real(lambda: sensor.rate_hz, sensor.set_rate),
            0x34: real(lambda: 1.0),
            0x38: real(lambda: sensor.max_rate_hz),
            0x40: real(lambda: settings().gain_db, sensor.set_gain),
            0x44: real(lambda: 0.0),
            0x48: real(lambda: 24.0),
            0x50: self._flag("rate_limited"),
            0x54: self._automatic("exposure"),
            0x58: self._automatic("gain"),
            0x5C: self._flag("trigger"),
            0x60: self._flag("gamma"),
            0x64: number(lambda: settings().chunks, lambda value: sensor.set_format(chunks=bool(value))),
            0x68: number(lambda: settings().binning, lambda value: sensor.set_format(binning=value)),
            0x6C: number(lambda: self.parameters_locked, self._lock),
            0x70: number(lambda: self._line, self._select),
            0x74: number(lambda: self._modes[self._line], self._mode),
            0x78: number(lambda: self._sources[self._line], self._source),
            0x7C: number(lambda: 0, lambda _: self._run(True)),
            0x80: number(lambda: 0, lambda _: self._run(False)),
            0x84: number(lambda: 0, lambda _: sensor.reset()),
            0x88: number(lambda: 0, self._user_set),
            0x8C: number(lambda: 0x0108_0001, self._pixel_format),
        }
        return {AT + offset: register for offset, register in registers.items()}

    def describe(self) -> bytes:
        """Return the description, as XML."""
        model, off_on = self.model, {"Off": 0, "On": 1}
        nodes = {}
        for name, at, most, step in (
            ("Width", 0x00, 0x10, model.size_step[1]), ("Height", 0x04, 0x14, model.size_step[0]),
            ("OffsetX", 0x08, 0x18, model.origin_step[1]), ("OffsetY", 0x0C, 0x1C, model.origin_step[0]),
        ):  # fmt: skip
            low = 0 if name.startswith("Offset") else step
            nodes[name] = xml.integer(name, f"{name}Reg", low=low, high=f"{name}Max", step=step)
            nodes[name] += xml.register(f"{name}Reg", AT + at) + xml.register(f"{name}Max", AT + most, access="RO")
        nodes["ExposureTime"] = xml.real("ExposureTime", AT + 0x20, AT + 0x24, AT + 0x28, "us")
        nodes["AcquisitionFrameRate"] = xml.real("AcquisitionFrameRate", AT + 0x30, AT + 0x34, AT + 0x38, "Hz")
        nodes["Gain"] = xml.real("Gain", AT + 0x40, AT + 0x44, AT + 0x48, "dB")
        for name, at, locked in (
            ("AcquisitionFrameRateEnable", 0x50, False), ("GammaEnable", 0x60, False), ("ChunkModeActive", 0x64, True),
        ):  # fmt: skip
            nodes[name] = xml.boolean(name, f"{name}Reg", locked=locked) + xml.register(f"{name}Reg", AT + at)
        for name, at, entries, selected in (
            ("ExposureAuto", 0x54, {"Off": 0, "Continuous": 1}, ""),
            ("GainAuto", 0x58, {"Off": 0, "Continuous": 1}, ""),
            ("TriggerMode", 0x5C, off_on, ""),
            ("LineSelector", 0x70, LINES, "LineMode</pSelected><pSelected>LineSource"),
            ("LineSource", 0x78, {"Off": 0, "ExposureActive": 5}, ""),
            ("UserSetSelector", 0x88, {"Default": 0}, "UserSetLoad"),
            ("PixelFormat", 0x8C, {"Mono8": 0x0108_0001}, ""),
        ):
            node = xml.enumeration(name, f"{name}Reg", entries, selected=selected)
            nodes[name] = node + xml.register(f"{name}Reg", AT + at)
        nodes["LineMode"] = xml.enumeration("LineMode", "LineModeReg", {"Input": 0, "Output": 1})
        nodes["LineMode"] = nodes["LineMode"].replace(
            '<Enumeration Name="LineMode">',
            '<Enumeration Name="LineMode"><pIsLocked>LineIsFixed</pIsLocked>',
        )
        nodes["LineMode"] += xml.register("LineModeReg", AT + 0x74)
        nodes["LineMode"] += (
            '<IntSwissKnife Name="LineIsFixed"><pVariable Name="LINE">LineSelectorReg</pVariable>'
            "<Formula>LINE &lt; 2</Formula></IntSwissKnife>"
        )
        nodes["TLParamsLocked"] = (
            '<Integer Name="TLParamsLocked"><pValue>LockReg</pValue><Min>0</Min><Max>1</Max></Integer>'
        ) + xml.register("LockReg", AT + 0x6C)
        for name in ("BinningHorizontal", "BinningVertical"):
            nodes[name] = (
                f'<Integer Name="{name}"><pIsLocked>TLParamsLocked</pIsLocked><pValue>{name}Reg</pValue><Min>1</Min>'
                "<Max>2</Max></Integer>"
            ) + xml.register(f"{name}Reg", AT + 0x68)
        for name, at in (("AcquisitionStart", 0x7C), ("AcquisitionStop", 0x80), ("UserSetLoad", 0x84)):
            nodes[name] = xml.command(name, f"{name}Reg", 1) + xml.register(f"{name}Reg", AT + at)
        return xml.description("VirtualStandardCamera", nodes)

    def _flag(self, name: str) -> Register:
        sensor = self._sensor
        return number(
            lambda: int(getattr(sensor.settings, name)), lambda value: setattr(sensor.settings, name, bool(value))
        )

    def _automatic(self, name: str) -> Register:
        sensor = self._sensor
        return number(
            lambda: int(name in sensor.settings.automatic), lambda value: sensor.set_automatic(name, bool(value))
        )

    def _lock(self, value: int) -> None:
        self.parameters_locked = bool(value)

    def _select(self, line: int) -> None:
        if line > max(LINES.values()):
            raise Refusal(INVALID_PARAMETER)
        self._line = line

    def _mode(self, mode: int) -> None:
        if self._line <= FIXED_OUTPUT:
            raise Refusal(ACCESS_DENIED)
        self._modes[self._line] = mode

    def _source(self, source: int) -> None:
        if not self._modes[self._line]:
            raise Refusal(ACCESS_DENIED)
        self._sources[self._line] = source

    def _run(self, on: bool) -> None:
        if on and not self.parameters_locked:
            raise Refusal(ACCESS_DENIED)
        self._acquire(on)

    def _user_set(self, value: int) -> None:
        if value:
            raise Refusal(INVALID_PARAMETER)

    def _pixel_format(self, value: int) -> None:
        if value != 0x0108_0001:
            raise Refusal(INVALID_PARAMETER)
