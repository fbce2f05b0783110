"""Any USB3 Vision camera, through the description that it carries and EMVA's reference reader (extra ``genicam``)."""

from __future__ import annotations

import io
import zipfile
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final

from napari_elsplus.errors import DeviceError, InputError
from napari_elsplus.hardware.limits import SensorLimits
from napari_elsplus.hardware.u3v.control import MANIFEST
from napari_elsplus.instrument.optics import LINE_RATE_HZ

if TYPE_CHECKING:
    from collections.abc import Iterator

    from napari_elsplus.hardware.protocols import Region
    from napari_elsplus.hardware.u3v.control import Control

MAX_FILE: Final = 4 << 20
"""Bytes of a description, packed; chosen: several times the usual size."""
MAX_TEXT: Final = 16 << 20
"""Bytes of a description, unpacked; chosen: four times `MAX_FILE`."""
MAX_ENTRIES: Final = 16
"""Descriptions in a camera's table; chosen: cameras have one or two."""
ZIPPED: Final = 1
"""File type of a packed description (GenCP 1.1, manifest entry)."""
LEFT_ON: Final = {
    "ChunkModeActive": False,
    "TriggerMode": "Off",
    "GammaEnable": False,
    "GammaEnabled": False,
    "BinningHorizontal": 1,
    "BinningVertical": 1,
    "DecimationHorizontal": 1,
    "DecimationVertical": 1,
    "ReverseX": False,
    "ReverseY": False,
}
"""Features (SFNC) that other programs may leave on and that change the images, with the values that do not."""
CHUNK: Final = 1 << 16
"""Bytes unpacked at once."""


def read_description(control: Control) -> bytes:
    """Read the GenICam description of a camera, unpacked.

    Parameters
    ----------
    control : Control
        Control channel of the camera.

    Raises
    ------
    DeviceError
        If there is none, it is longer than any description is, or it is no XML.
    """
    table = control.read_number(MANIFEST, 8)
    entries = control.read_number(table, 8)
    if not 0 < entries <= MAX_ENTRIES:
        raise DeviceError(f"the camera lists {entries} descriptions of itself", "update its firmware")
    kind, address, size = (control.read_number(table + 8 + at, count) for at, count in ((4, 4), (8, 8), (16, 8)))
    if not 0 < size <= MAX_FILE:
        raise DeviceError(f"the camera's description has {size} bytes", "update its firmware")
    data = control.read(address, size)
    if kind >> 10 & 0x3F == ZIPPED:
        data = _unzip(data)
    if b"<" not in data[:256] or b"RegisterDescription" not in data[:65536]:
        raise DeviceError("the camera's description is no GenICam XML", "update its firmware")
    return data


def _unzip(data: bytes) -> bytes:
    """Unpack the only file of an archive, up to a limit, whatever its directory states."""
    text = bytearray()
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive, archive.open(archive.namelist()[0]) as file:
            while part := file.read(CHUNK):
                text += part
                if len(text) > MAX_TEXT:
                    raise DeviceError(
                        f"the camera's description unpacks to more than {MAX_TEXT} bytes", "update its firmware"
                    )
    except DeviceError:
        raise
    except Exception as error:  # of a spoilt archive zipfile, and what unpacks, raise their own
        raise DeviceError(f"the camera's description cannot be unpacked ({error})", "update its firmware") from error
    return bytes(text)


@contextmanager
def _translate_errors() -> Iterator[None]:
    """Turn the errors of the reader, of a feature that is not available for instance, into a `DeviceError`."""
    from genicam.genapi import GenericException

    try:
        yield
    except GenericException as error:
        reason = str(error).partition(" (file")[0]
        raise DeviceError(
            f"the camera's description does not allow it ({reason})", "see the camera's manual"
        ) from error


class GenicamFeatures:
    """Features by their standard names; see `napari_elsplus.hardware.u3v.camera.Features`.

    Parameters
    ----------
    control : Control
        Control channel of the camera.
    line_rate_hz : float
        Rows per second; there is no standard feature for it.
    strobe_line : int
        Line that carries the strobe.

    Raises
    ------
    DeviceError
        If the extra is not installed, or the description cannot be read.
    """

    def __init__(self, control: Control, *, line_rate_hz: float = LINE_RATE_HZ, strobe_line: int = 1) -> None:
        try:
            from genicam import genapi
        except ImportError as error:
            raise DeviceError(
                "the genicam extra is not installed, so only the Flea3 can be driven",
                "pip install 'napari-elsplus[genicam]'",
            ) from error
        self._line_rate_hz, self._strobe_line, self._genapi = line_rate_hz, strobe_line, genapi
        self._nodes, self._port = genapi.NodeMap(), _port(genapi, control)  # the reader does not keep the port
        try:
            self._nodes.load_xml_from_string(read_description(control).decode("utf-8", "replace"))
            self._nodes.connect(self._port, "Device")
        except genapi.GenericException as error:
            raise DeviceError(f"the camera's description cannot be read ({error})", "update its firmware") from error

    @property
    def line_period_s(self) -> float:
        """Seconds per row."""
        return 1 / self._line_rate_hz

    @property
    @_translate_errors()
    def frame_rate_hz(self) -> float:
        """Frame rate that the camera reports, in Hz."""
        return float(self._node("AcquisitionFrameRate", "AcquisitionFrameRateAbs").value)

    @property
    @_translate_errors()
    def sensor(self) -> SensorLimits:
        """Size of the sensor, and its steps; the region is moved to the sensor's corner, and has to be set anew."""
        for name in ("OffsetX", "OffsetY"):
            self._set(0, name)
        height, width = self._node("Height"), self._node("Width")
        steps = (int(self._node(name).inc) for name in ("Height", "Width", "OffsetY", "OffsetX"))
        return SensorLimits(int(height.max), int(width.max), *steps)

    @property
    @_translate_errors()
    def frame_rate_limits_hz(self) -> tuple[float, float]:
        """Lowest and highest frame rate, in Hz."""
        rate = self._node("AcquisitionFrameRate", "AcquisitionFrameRateAbs")
        return float(rate.min), float(rate.max)

    @_translate_errors()
    def configure(self, region: Region, exposure_s: float, frame_rate_hz: float, gain_db: float) -> None:
        """Set the camera; see :meth:`napari_elsplus.hardware.u3v.camera.Features.configure`."""
        for name in ("OffsetX", "OffsetY"):
            self._set(0, name)
        self._set(region.cols, "Width")
        self._set(region.rows, "Height")
        self._set(region.col, "OffsetX")
        self._set(region.row, "OffsetY")
        self._set_if_there("Mono8", "PixelFormat")
        for name in ("ExposureAuto", "GainAuto", "AcquisitionFrameRateAuto"):
            self._set_if_there("Off", name)
        for name in ("AcquisitionFrameRateEnable", "AcquisitionFrameRateEnabled"):
            self._set_if_there(True, name)
        exposure = self._node("ExposureTime", "ExposureTimeAbs")
        self._set(exposure.min, "ExposureTime", "ExposureTimeAbs")  # a long one limits the rate
        self._set(frame_rate_hz, "AcquisitionFrameRate", "AcquisitionFrameRateAbs")
        self._set(exposure_s * 1e6, "ExposureTime", "ExposureTimeAbs")
        self._set(gain_db, "Gain")
        self._set_if_there(f"Line{self._strobe_line}", "LineSelector")
        self._set_if_there("Output", "LineMode")
        self._set("ExposureActive", "LineSource")

    @_translate_errors()
    def reset(self) -> None:
        """Load the default settings; see :meth:`napari_elsplus.hardware.u3v.camera.Features.reset`."""
        self._set_if_there("Default", "UserSetSelector")
        if self._nodes.has_node("UserSetLoad") and self._genapi.is_writable(
            load := self._nodes.get_node("UserSetLoad")
        ):
            load.execute()
        for name, value in LEFT_ON.items():
            self._set_if_there(value, name)

    @_translate_errors()
    def start(self) -> None:
        """Begin to acquire; from then on the camera may lock what changes its transfers."""
        self._set_if_there(1, "TLParamsLocked")
        self._node("AcquisitionStart").execute()

    @_translate_errors()
    def stop(self) -> None:
        """End acquiring."""
        self._node("AcquisitionStop").execute()
        self._set_if_there(0, "TLParamsLocked")

    def _node(self, *names: str) -> Any:
        for name in names:
            if self._nodes.has_node(name):
                return self._nodes.get_node(name)
        raise DeviceError(f"the camera has no feature {names[0]}", "this camera cannot be used")

    def _set(self, value: object, *names: str) -> None:
        node = self._node(*names)
        try:
            node.value = value
        except self._genapi.GenericException as error:
            allowed = f"{node.min:g} to {node.max:g}" if hasattr(node, "min") else "other values"
            raise InputError(f"{names[0]} = {value}", f"the camera allows {allowed}") from error

    def _set_if_there(self, value: object, name: str) -> None:
        """Set a feature that not every camera has; one that is fixed must hold the value already."""
        if not self._nodes.has_node(name):
            return
        node = self._nodes.get_node(name)
        if self._genapi.is_writable(node):
            self._set(value, name)
        elif self._genapi.is_readable(node) and node.value != value:
            raise DeviceError(f"the camera's {name} is {node.value} and cannot be set to {value}", "see its manual")


def _port(genapi: Any, control: Control) -> Any:
    """Return a port through which the GenApi reader reaches the camera's registers."""

    class Port(genapi.AbstractPort):  # type: ignore[misc] # known at run time only
        def get_access_mode(self) -> int:
            return int(genapi.EAccessMode.RW)

        def read(self, address: int, length: int) -> bytes:
            return control.read(address, length)

        def write(self, address: int, data: bytes) -> None:
            control.write(address, bytes(data))

    return Port()
