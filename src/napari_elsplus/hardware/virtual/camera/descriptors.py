"""USB descriptors of the virtual camera, byte by byte (USB 3.0, chapter 9.6; USB3 Vision 1.0.1, device information)."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Iterator

CONTROL_OUT, CONTROL_IN, STREAM_IN = 0x01, 0x81, 0x82
"""Endpoint addresses."""
STRINGS: Final = ("napari-elsplus", "virtual camera")
"""String descriptors 1 and 2; 3 is the serial number."""
DEVICE, CONFIGURATION, INTERFACE, ENDPOINT, U3V_INFO = 0x01, 0x02, 0x04, 0x05, 0x24
"""Descriptor types."""
_FIELDS: Final = {
    DEVICE: "bLength bDescriptorType bcdUSB:2 bDeviceClass bDeviceSubClass bDeviceProtocol bMaxPacketSize0 idVendor:2 "
    "idProduct:2 bcdDevice:2 iManufacturer iProduct iSerialNumber bNumConfigurations",
    CONFIGURATION: "bLength bDescriptorType wTotalLength:2 bNumInterfaces bConfigurationValue iConfiguration "
    "bmAttributes bMaxPower",
    INTERFACE: "bLength bDescriptorType bInterfaceNumber bAlternateSetting bNumEndpoints bInterfaceClass "
    "bInterfaceSubClass bInterfaceProtocol iInterface",
    ENDPOINT: "bLength bDescriptorType bEndpointAddress bmAttributes wMaxPacketSize:2 bInterval",
}
"""Fields of the descriptors in order, those of two bytes marked."""


def device(iidc: bool, super_speed: bool = True) -> bytes:
    """Return the device descriptor of a USB3 Vision camera, or of one with the older IIDC firmware.

    Parameters
    ----------
    iidc : bool
        It has the older firmware.
    super_speed : bool
        The link is USB 3; otherwise USB 2, where the versions and the packets' sizes are others.
    """
    classes, product = ((0, 0, 0), 0x3006) if iidc else ((0xEF, 0x02, 0x01), 0x3300)
    version, packet = ((0x00, 0x03), 9) if super_speed else ((0x10, 0x02), 64)  # 9: 2 ** 9 bytes
    ids = [0x10, 0x1E, *product.to_bytes(2, "little")]
    return bytes([18, DEVICE, *version, *classes, packet, *ids, 1, 0, 1, 2, 3, 1])


def configuration(iidc: bool, super_speed: bool = True) -> bytes:
    """Return the configuration descriptor with all that belongs to it.

    Parameters
    ----------
    iidc, super_speed : bool
        As in `device`.
    """
    classes = (0xFF, 0, 0) if iidc else (0xEF, 0x05, 0x00)
    parts = [] if iidc else [bytes([8, 0x0B, 0, 2, 0xEF, 0x05, 0x00, 0])]  # the association of both interfaces
    parts.append(bytes([9, INTERFACE, 0, 0, 2, *classes, 0]))
    if not iidc:
        versions = bytes([1, 0, 1, 0, 1, 0, 1, 0])  # GenCP 1.1, USB3 Vision 1.1
        parts.append(bytes([20, U3V_INFO, 0x01, *versions, 3, 1, 2, 0, 0, 0, 3, 0, 0x08]))
    parts += [_endpoint(CONTROL_OUT, super_speed), _endpoint(CONTROL_IN, super_speed)]
    if not iidc:
        parts += [bytes([9, INTERFACE, 1, 0, 1, 0xEF, 0x05, 0x02, 0]), _endpoint(STREAM_IN, super_speed)]
    body = b"".join(parts)
    total = (9 + len(body)).to_bytes(2, "little")
    power = 112 if super_speed else 250  # 896 mA in units of 8 mA, 500 mA in units of 2 mA
    return bytes([9, CONFIGURATION, *total, 1 if iidc else 2, 1, 0, 0x80, power]) + body


def string(index: int, serial: str) -> bytes:
    """Return the string descriptor of an index: languages, maker, product, or the `serial` number."""
    body = b"\x09\x04" if index == 0 else (*STRINGS, serial)[index - 1].encode("utf-16-le")
    return bytes([2 + len(body), 3]) + body


def parse(raw: bytes) -> Iterator[SimpleNamespace]:
    """Parse `raw` descriptors into pyusb's fields, in order; those of other types go to the one before."""
    last: SimpleNamespace | None = None
    while raw:
        part, raw = raw[: raw[0]], raw[raw[0] :]
        if part[1] in _FIELDS:
            if last is not None:
                yield last
            last = _named(part)
        elif last is not None:
            last.extra_descriptors += list(part)
    if last is not None:
        yield last


def _named(part: bytes) -> SimpleNamespace:
    values: dict[str, Any] = {"extra_descriptors": [], "bRefresh": 0, "bSynchAddress": 0}
    at = 0
    for field in _FIELDS[part[1]].split():
        name, _, size = field.partition(":")
        values[name] = int.from_bytes(part[at : at + int(size or 1)], "little")
        at += int(size or 1)
    return SimpleNamespace(**values)


def _endpoint(address: int, super_speed: bool) -> bytes:
    """Return a bulk endpoint: of 1024 bytes with its SuperSpeed companion, or of 512 bytes."""
    if super_speed:
        return bytes([7, ENDPOINT, address, 0x02, 0x00, 0x04, 0, 6, 0x30, 0, 0, 0, 0])
    return bytes([7, ENDPOINT, address, 0x02, 0x00, 0x02, 0])
