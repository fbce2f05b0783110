"""GenICam descriptions (GenApi schema 1.1) of the virtual cameras, from nodes by the features' standard names."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Mapping

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
