"""GenICam description of the virtual camera: the features that a line scan needs, by their standard names."""

from __future__ import annotations

from typing import Final

from napari_elsplus.hardware.u3v import flea3

HEADER: Final = """<?xml version="1.0" encoding="utf-8"?>
<RegisterDescription ModelName="VirtualCamera" VendorName="napari-elsplus"
 StandardNameSpace="None" SchemaMajorVersion="1" SchemaMinorVersion="1" SchemaSubMinorVersion="0"
 MajorVersion="1" MinorVersion="0" SubMinorVersion="0" ToolTip="Virtual USB3 Vision camera"
 ProductGuid="6c5d7c1e-2c7b-4f0b-9d61-6d6e2a1c9f11" VersionGuid="d1c5b6d8-53b0-4bb4-a6a5-0f4bd1b4b7f2"
 xmlns="http://www.genicam.org/GenApi/Version_1_1">
"""
ROOT: Final = """<Category Name="Root"><pFeature>DeviceVendorName</pFeature><pFeature>Width</pFeature>
<pFeature>Height</pFeature><pFeature>OffsetX</pFeature><pFeature>OffsetY</pFeature><pFeature>ExposureTime</pFeature>
<pFeature>Gain</pFeature><pFeature>AcquisitionFrameRateEnable</pFeature><pFeature>AcquisitionFrameRate</pFeature>
<pFeature>AcquisitionStart</pFeature><pFeature>AcquisitionStop</pFeature><pFeature>LineSource</pFeature></Category>
<StringReg Name="DeviceVendorName"><Address>0x4</Address><Length>64</Length><AccessMode>RO</AccessMode>
<pPort>Device</pPort></StringReg>
"""


def describe() -> bytes:
    """Return the description, as XML."""
    halves = {"Width": (flea3.SIZE, 16, 31), "Height": (flea3.SIZE, 0, 15)}
    halves |= {"OffsetX": (flea3.OFFSET, 16, 31), "OffsetY": (flea3.OFFSET, 0, 15)}
    limits = {"Width": (16, 16), "Height": (4, 4), "OffsetX": (0, 4), "OffsetY": (0, 2)}
    nodes = [HEADER, ROOT]
    for name, (register, low, high) in halves.items():
        nodes.append(_integer(name, register, low, high, *limits[name]))
    nodes.append(_float("AcquisitionFrameRate", flea3.RATE, flea3.RATE_MIN, flea3.RATE_MAX, "Hz"))
    nodes.append(_float("Gain", flea3.GAIN, flea3.GAIN_MIN, flea3.GAIN_MAX, "dB"))
    nodes.append(_float("ExposureSeconds", flea3.EXPOSURE, flea3.EXPOSURE_MIN, flea3.EXPOSURE_MAX, "s"))
    nodes.append(
        '<Converter Name="ExposureTime"><FormulaTo>FROM/1000000</FormulaTo><FormulaFrom>TO*1000000</FormulaFrom>'
        "<pValue>ExposureSeconds</pValue><Unit>us</Unit></Converter>"
    )
    nodes.append(_bit("AcquisitionFrameRateEnable", flea3.FRAME_RATE_MODE, 25))
    nodes.append(_command("AcquisitionStart", flea3.ACQUISITION, flea3.ACQUIRE))
    nodes.append(_command("AcquisitionStop", flea3.ACQUISITION, 0))
    nodes.append(_strobe())
    nodes.append('<Port Name="Device"/></RegisterDescription>')
    return "\n".join(nodes).encode()


def _place(register: int) -> str:
    return (
        f"<Address>{flea3.BASE + register:#x}</Address><Length>4</Length><AccessMode>RW</AccessMode>"
        "<pPort>Device</pPort><Cachable>NoCache</Cachable>"
    )


def _integer(name: str, register: int, low: int, high: int, least: int, step: int) -> str:
    return (
        f'<Integer Name="{name}"><pValue>{name}Reg</pValue><Min>{least}</Min><Inc>{step}</Inc></Integer>'
        f'<MaskedIntReg Name="{name}Reg">{_place(register)}<LSB>{low}</LSB><MSB>{high}</MSB><Sign>Unsigned</Sign>'
        "<Endianess>LittleEndian</Endianess></MaskedIntReg>"
    )


def _float(name: str, register: int, low: int, high: int, unit: str) -> str:
    registers = "".join(
        f'<FloatReg Name="{name}{part}">{_place(at)}<Endianess>LittleEndian</Endianess></FloatReg>'
        for part, at in (("Reg", register), ("Min", low), ("Max", high))
    )
    return (
        f'<Float Name="{name}"><pValue>{name}Reg</pValue><pMin>{name}Min</pMin><pMax>{name}Max</pMax>'
        f"<Unit>{unit}</Unit></Float>{registers}"
    )


def _bit(name: str, register: int, bit: int) -> str:
    return (
        f'<Boolean Name="{name}"><pValue>{name}Reg</pValue><OnValue>1</OnValue><OffValue>0</OffValue></Boolean>'
        f'<MaskedIntReg Name="{name}Reg">{_place(register)}<Bit>{bit}</Bit><Sign>Unsigned</Sign>'
        "<Endianess>LittleEndian</Endianess></MaskedIntReg>"
    )


def _command(name: str, register: int, value: int) -> str:
    return (
        f'<Command Name="{name}"><pValue>{name}Reg</pValue><CommandValue>{value}</CommandValue></Command>'
        f'<IntReg Name="{name}Reg">{_place(register)}<Sign>Unsigned</Sign><Endianess>LittleEndian</Endianess></IntReg>'
    )


def _strobe() -> str:
    """GPIO 1 as the strobe, on while the sensor is exposed."""
    return (
        '<Enumeration Name="LineSource"><EnumEntry Name="Off"><Value>0</Value></EnumEntry>'
        f'<EnumEntry Name="ExposureActive"><Value>{flea3.GPIO_STROBE}</Value></EnumEntry>'
        "<pValue>LineSourceReg</pValue></Enumeration>"
        f'<IntReg Name="LineSourceReg">{_place(flea3.GPIO_MODE + 0x10)}<Sign>Unsigned</Sign>'
        "<Endianess>LittleEndian</Endianess></IntReg>"
    )
