"""The sizes of a frame's transfers, agreed with the camera before its stream is enabled."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from napari_elsplus.errors import DeviceError

if TYPE_CHECKING:
    from napari_elsplus.hardware.u3v.control import Control

# Stream interface registers (USB3 Vision 1.0, table 4-22), from the SIRM's address.
INFO, ENABLE, PAYLOAD_BYTES, LEADER_BYTES, TRAILER_BYTES = 0x00, 0x04, 0x08, 0x10, 0x14
MAX_LEADER, TRANSFER_BYTES, TRANSFER_COUNT, FINAL_1, FINAL_2, MAX_TRAILER = 0x18, 0x1C, 0x20, 0x24, 0x28, 0x2C

MAX_TRANSFER: Final = 1 << 20
"""Bytes of one bulk transfer at most; chosen: 1 MiB, few enough calls at 167 MB/s."""
PACKET: Final = 1024
"""Bytes of a bulk packet at USB 3: leaders and trailers are shorter, and no camera's transfers are."""
SURPLUS: Final = 1 << 16
"""Bytes by which a device's payload may exceed the image; chosen: padding and chunk data fit, no second image does."""


def negotiate_transfers(control: Control, frame_shape: tuple[int, int]) -> list[int]:
    """Write the sizes of a frame's transfers to the device, and return those that it holds.

    Parameters
    ----------
    control : Control
        Control channel.
    frame_shape : tuple of int
        Rows and columns.

    Returns
    -------
    list of int
        Bytes of each transfer.

    Raises
    ------
    DeviceError
        If leaders, trailers, payload or transfers of the device have impossible sizes.
    """
    sirm, image = control.sirm, frame_shape[0] * frame_shape[1]
    unit = 1 << min(control.read_number(sirm + INFO) >> 24, 16)
    payload = control.read_number(sirm + PAYLOAD_BYTES, 8)
    edges = max(control.read_number(sirm + LEADER_BYTES), control.read_number(sirm + TRAILER_BYTES))
    if not image <= payload <= image + SURPLUS or edges > PACKET:
        raise DeviceError(
            f"the camera announces frames of {payload} bytes for {frame_shape[0]} x {frame_shape[1]} pixels",
            "restart the camera; only Mono8 is read",
        )
    control.write_number(sirm + MAX_LEADER, PACKET)
    control.write_number(sirm + MAX_TRAILER, PACKET)
    largest = MAX_TRANSFER
    while True:
        size, count, final = _divide(payload, largest // unit * unit, unit)
        for register, value in ((TRANSFER_BYTES, size), (TRANSFER_COUNT, count), (FINAL_1, final), (FINAL_2, 0)):
            control.write_number(sirm + register, value)
        held = control.read_number(sirm + TRANSFER_BYTES)
        if held == size:
            return [size] * count + ([final] if final else [])
        if not max(unit, PACKET) <= held < size:
            raise DeviceError(f"the camera holds transfers of {held} bytes instead of {size}", "restart the camera")
        largest = held


def _divide(payload: int, largest: int, unit: int) -> tuple[int, int, int]:
    """Return size and number of equal transfers, and the size of the last one, for a payload."""
    if payload <= largest:
        return -(-payload // unit) * unit, 1, 0
    count, rest = divmod(payload, largest)
    return largest, count, -(-rest // unit) * unit
