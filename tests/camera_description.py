"""GenICam descriptions (GenApi schema 1.1) of the virtual cameras, from nodes by the features' standard names."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from napari_elsplus.hardware.virtual.camera.bootstrap import MANIFEST
from napari_elsplus.hardware.virtual.camera.iidc import COMMANDS, STROBES, Flea3Registers
from napari_elsplus.hardware.virtual.camera.memory import constant, number

if TYPE_CHECKING:
    from collections.abc import Mapping

    from napari_elsplus.hardware.virtual.camera.device import VirtualCamera

XML: Final = 0x4_0000
"""Address of the description; chosen, a host has to read it."""
HEADER: Final = """<?xml version="1.0" encoding="utf-8"?>
<RegisterDescription ModelName="{model}" VendorName="napari_elsplus"
 StandardNameSpace="None" SchemaMajorVersion="1" SchemaMinorVersion="1" SchemaSubMinorVersion="0"
 MajorVersion="1" MinorVersion="1" SubMinorVersion="0" ToolTip="Virtual USB3 Vision camera"
 ProductGuid="6c5d7c1e-2c7b-4f0b-9d61-6d6e2a1c9f11" VersionGuid="d1c5b6d8-53b0-4bb4-a6a5-0f4bd1b4b7f2"
 xmlns="http://www.genicam.org/GenApi/Version_1_1">
"""
IDENTITY: Final = "".join(
    f'<StringReg Name="{name}"><Address>{address:#x}</Address><Length>64</Length><AccessMode>RO</AccessMode>'
    "<pPort>Device</pPort></StringReg>\n"
    for name, address in (("DeviceVendorName", 0x4), ("DeviceModelName", 0x44), ("DeviceID", 0x144))
)


def description(model: str, features: Mapping[str, str]) -> bytes:
    """Return a description, as XML.

    Parameters
    ----------
    model : str
        Name of the camera.
    features : mapping
        Nodes by the names of their features.
    """
    names = ["DeviceVendorName", "DeviceModelName", "DeviceID", *features]
    root = "".join(f"<pFeature>{name}</pFeature>" for name in names)
    nodes = "\n".join(features.values())
    head = HEADER.format(model=model) + f'<Category Name="Root">{root}</Category>\n'
    return f'{head}{IDENTITY}{nodes}\n<Port Name="Device"/></RegisterDescription>'.encode()


def register(name: str, address: int, *, bits: tuple[int, int] = (0, 31), access: str = "RW", size: int = 4) -> str:
    """Return the node of an unsigned number in the bits of a register.

    Parameters
    ----------
    name : str
        Its name.
    address : int
        First byte.
    bits : tuple of int
        Lowest and highest bit.
    access : str
        ``RW``, ``RO`` or ``WO``.
    size : int
        Bytes.
    """
    place = (
        f"<Address>{address:#x}</Address><Length>{size}</Length><AccessMode>{access}</AccessMode>"
        "<pPort>Device</pPort><Cachable>NoCache</Cachable>"
    )
    kind, mask = "IntReg", ""
    if bits != (0, 31):
        kind, mask = "MaskedIntReg", f"<LSB>{bits[0]}</LSB><MSB>{bits[1]}</MSB>"
    return f'<{kind} Name="{name}">{place}{mask}<Sign>Unsigned</Sign><Endianess>LittleEndian</Endianess></{kind}>'


def integer(name: str, value: str, *, low: int, high: str, step: int, locked: bool = True) -> str:
    """Return the node of a number whose largest value is in another node.

    Parameters
    ----------
    name : str
        Feature.
    value : str
        Node of the value's register.
    low, step : int
        Smallest value, and step.
    high : str
        Node of the largest value.
    locked : bool
        It may not be changed while ``TLParamsLocked`` is set.
    """
    lock = "<pIsLocked>TLParamsLocked</pIsLocked>" if locked else ""
    return (
        f'<Integer Name="{name}">{lock}<pValue>{value}</pValue><Min>{low}</Min><pMax>{high}</pMax><Inc>{step}</Inc>'
        "</Integer>"
    )


def real(name: str, at: int, low: int, high: int, unit: str) -> str:
    """Return the nodes of a float with limits, each in a register.

    Parameters
    ----------
    name : str
        Feature.
    at, low, high : int
        Addresses of value and limits.
    unit : str
        Unit.
    """
    registers = "".join(
        f'<FloatReg Name="{name}{part}"><Address>{address:#x}</Address><Length>4</Length><AccessMode>{access}'
        "</AccessMode><pPort>Device</pPort><Cachable>NoCache</Cachable><Endianess>LittleEndian</Endianess></FloatReg>"
        for part, address, access in (("Reg", at, "RW"), ("Min", low, "RO"), ("Max", high, "RO"))
    )
    return (
        f'<Float Name="{name}"><pValue>{name}Reg</pValue><pMin>{name}Min</pMin><pMax>{name}Max</pMax>'
        f"<Unit>{unit}</Unit></Float>{registers}"
    )


def boolean(name: str, value: str, *, on: int = 1, locked: bool = False) -> str:
    """Return the node of a switch.

    Parameters
    ----------
    name : str
        Feature.
    value : str
        Node of its register.
    on : int
        Value that means on.
    locked : bool
        It may not be changed while ``TLParamsLocked`` is set.
    """
    lock = "<pIsLocked>TLParamsLocked</pIsLocked>" if locked else ""
    return (
        f'<Boolean Name="{name}">{lock}<pValue>{value}</pValue><OnValue>{on}</OnValue><OffValue>0</OffValue></Boolean>'
    )


def enumeration(name: str, value: str, entries: Mapping[str, int], *, selected: str = "", locked: bool = False) -> str:
    """Return the node of a choice.

    Parameters
    ----------
    name : str
        Feature.
    value : str
        Node of its register.
    entries : mapping
        Values by the names of the choices.
    selected : str
        Feature of which this is the selector; empty: of none.
    locked : bool
        It may not be changed while ``TLParamsLocked`` is set.
    """
    choices = "".join(f'<EnumEntry Name="{entry}"><Value>{code}</Value></EnumEntry>' for entry, code in entries.items())
    lock = "<pIsLocked>TLParamsLocked</pIsLocked>" if locked else ""
    chosen = f"<pSelected>{selected}</pSelected>" if selected else ""
    return f'<Enumeration Name="{name}">{lock}{choices}<pValue>{value}</pValue>{chosen}</Enumeration>'


def command(name: str, value: str, code: int) -> str:
    """Return the node of a command that writes a `code`.

    Parameters
    ----------
    name : str
        Feature.
    value : str
        Node of its register.
    code : int
        Value that is written.
    """
    return f'<Command Name="{name}"><pValue>{value}</pValue><CommandValue>{code}</CommandValue></Command>'


def describe_flea3() -> bytes:
    """Return the description of the virtual Flea3, as XML."""
    rows, cols = Flea3Registers.model.shape
    nodes = {"TLParamsLocked": '<Integer Name="TLParamsLocked"><Value>0</Value></Integer>'}
    for name, at, bits, low, step, size in (
        ("Width", 0xA0C, (16, 31), 16, 16, cols), ("Height", 0xA0C, (0, 15), 4, 4, rows),
        ("OffsetX", 0xA08, (16, 31), 0, 4, cols), ("OffsetY", 0xA08, (0, 15), 0, 2, rows),
    ):  # fmt: skip
        other = {"Width": "OffsetX", "Height": "OffsetY", "OffsetX": "Width", "OffsetY": "Height"}[name]
        nodes[name] = integer(name, f"{name}Reg", low=low, high=f"{name}Max", step=step)
        nodes[name] += register(f"{name}Reg", COMMANDS + at, bits=bits)
        nodes[name] += (
            f'<IntSwissKnife Name="{name}Max"><pVariable Name="OTHER">{other}Reg</pVariable>'
            f"<Formula>{size} - OTHER</Formula></IntSwissKnife>"
        )
    nodes["PayloadSize"] = register("PayloadSize", COMMANDS + 0x5410, access="RO")
    nodes["ExposureTime"] = (
        '<Converter Name="ExposureTime"><FormulaTo>FROM/1000000</FormulaTo><FormulaFrom>TO*1000000</FormulaFrom>'
        "<pValue>ExposureSeconds</pValue><Unit>us</Unit></Converter>"
    ) + real("ExposureSeconds", COMMANDS + 0x918, COMMANDS + 0x910, COMMANDS + 0x914, "s")
    nodes["Gain"] = real("Gain", COMMANDS + 0x928, COMMANDS + 0x920, COMMANDS + 0x924, "dB")
    rate = "AcquisitionFrameRate"
    nodes[rate] = real(rate, COMMANDS + 0x968, COMMANDS + 0x960, COMMANDS + 0x964, "Hz")
    nodes[f"{rate}Enabled"] = boolean(f"{rate}Enabled", "RateOnReg")
    nodes[f"{rate}Enabled"] += register("RateOnReg", COMMANDS + 0x83C, bits=(25, 25))
    choice = {"Off": 0, "Continuous": 1}
    for name, at in ((f"{rate}Auto", 0x83C), ("ExposureAuto", 0x81C), ("GainAuto", 0x820)):
        nodes[name] = enumeration(name, f"{name}Reg", choice)
        nodes[name] += register(f"{name}Reg", COMMANDS + at, bits=(24, 24))
    for name, at in (("TriggerMode", 0x830), ("GammaEnabled", 0x818)):
        node = enumeration(name, f"{name}Reg", {"Off": 0, "On": 1})
        node = boolean(name, f"{name}Reg") if name == "GammaEnabled" else node
        nodes[name] = node + register(f"{name}Reg", COMMANDS + at, bits=(25, 25))
    nodes["AcquisitionStart"] = command("AcquisitionStart", "AcquisitionReg", 1 << 31)
    nodes["AcquisitionStop"] = command("AcquisitionStop", "AcquisitionReg", 0)
    nodes["AcquisitionStop"] += register("AcquisitionReg", COMMANDS + 0x4030)
    nodes["PixelFormat"] = enumeration("PixelFormat", "CodingReg", {"Mono8": 0}, locked=True)
    nodes["PixelFormat"] += register("CodingReg", COMMANDS + 0x4070, bits=(24, 31))
    nodes["LineMode"] = enumeration("LineMode", "LineModeReg", {"Input": 0, "Output": 3})
    nodes["LineMode"] += register("LineModeReg", COMMANDS + 0x1120, bits=(16, 19))
    nodes["LineSource"] = enumeration("LineSource", "LineSourceReg", {"Off": 0, "ExposureActive": 1})
    nodes["LineSource"] += register("LineSourceReg", STROBES + 0x304, bits=(20, 20))
    return description("VirtualFlea3", nodes)


def add_description(camera: VirtualCamera, xml: bytes | None = None) -> None:
    """Give a virtual camera the table of descriptions (GenCP 1.1, manifest table), with one: by default a Flea3's."""
    text = describe_flea3() if xml is None else xml
    camera.memory.add(
        {
            MANIFEST: number(lambda: 1, size=8),
            MANIFEST + 0x08: number(lambda: 0x0101_0000),  # version 1.1.0 of the file, not compressed
            MANIFEST + 0x0C: number(lambda: 0x0101 << 16 | 0),  # schema 1.1
            MANIFEST + 0x10: number(lambda: XML, size=8),
            MANIFEST + 0x18: number(lambda: len(text), size=8),
            MANIFEST + 0x20: constant(bytes(40)),  # SHA-1 (not given) and reserved bytes
            XML: constant(text),
        }
    )
