"""The aravis library's camera, as far as the rig uses it: another implementation of USB3 Vision, on libusb as well."""

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_elsplus.hardware.protocols import Region

SYNCHRONOUS = 0
"""``ARV_UV_USB_MODE_SYNC``: the other mode starves where the processor is emulated."""
BUFFERS = 64
"""Frames that aravis may keep while the emulated processor is busy elsewhere."""


class Error(ctypes.Structure):
    """GLib's ``GError``."""

    _fields_ = (("domain", ctypes.c_uint), ("code", ctypes.c_int), ("message", ctypes.c_char_p))


class AravisCamera:
    """The first camera that aravis finds."""

    def __init__(self) -> None:
        self._library = ctypes.CDLL("libaravis-0.8.so.0")
        self._call("arv_update_device_list", None)
        self._camera = self._checked("arv_camera_new", ctypes.c_void_p, None)

    def text(self, feature: str) -> str:
        """Return a feature as text."""
        device = self._call("arv_camera_get_device", ctypes.c_void_p, self._camera)
        return self._checked("arv_device_get_string_feature_value", ctypes.c_char_p, device, feature.encode()).decode()

    @contextmanager
    def streaming(self, region: Region, rate_hz: float) -> Iterator[Any]:
        """Stream, and return what reads a frame: its status (0: success), its number and its pixels."""
        box = (ctypes.c_int(value) for value in (region.col, region.row, region.cols, region.rows))
        self._checked("arv_camera_set_region", None, self._camera, *box)
        self._checked("arv_camera_set_string", None, self._camera, b"AcquisitionFrameRateAuto", b"Off")
        self._checked("arv_camera_set_boolean", None, self._camera, b"AcquisitionFrameRateEnabled", ctypes.c_int(1))
        self._checked("arv_camera_set_frame_rate", None, self._camera, ctypes.c_double(rate_hz))
        device = self._call("arv_camera_get_device", ctypes.c_void_p, self._camera)
        self._call("arv_uv_device_set_usb_mode", None, device, ctypes.c_int(SYNCHRONOUS))
        payload = self._checked("arv_camera_get_payload", ctypes.c_uint, self._camera)
        stream = self._checked("arv_camera_create_stream", ctypes.c_void_p, self._camera, None, None)
        for _ in range(BUFFERS):
            buffer = self._call("arv_buffer_new_allocate", ctypes.c_void_p, ctypes.c_size_t(payload))
            self._call("arv_stream_push_buffer", None, stream, buffer)
        self._checked("arv_camera_start_acquisition", None, self._camera)

        def read() -> tuple[int, int, NDArray[np.uint8]]:
            buffer = self._call("arv_stream_timeout_pop_buffer", ctypes.c_void_p, stream, ctypes.c_uint64(5_000_000))
            assert buffer, "no frame within 5 s"
            size = ctypes.c_size_t()
            data = self._call("arv_buffer_get_data", ctypes.c_void_p, buffer, ctypes.byref(size))
            pixels = np.frombuffer(ctypes.string_at(data, size.value), np.uint8)
            frame = (
                self._call("arv_buffer_get_status", ctypes.c_int, buffer),
                self._call("arv_buffer_get_frame_id", ctypes.c_uint64, buffer),
                pixels[: region.rows * region.cols].reshape(region.shape),
            )
            self._call("arv_stream_push_buffer", None, stream, buffer)
            return frame

        try:
            yield read
        finally:
            self._checked("arv_camera_stop_acquisition", None, self._camera)
            self._call("g_object_unref", None, stream)

    def close(self) -> None:
        """Let the camera go."""
        self._call("g_object_unref", None, self._camera)

    def _call(self, name: str, result: Any, *arguments: Any) -> Any:
        function = getattr(self._library, name)
        function.restype = result
        return function(*(ctypes.c_void_p(a) if isinstance(a, int) else a for a in arguments))

    def _checked(self, name: str, result: Any, *arguments: Any) -> Any:
        error = ctypes.POINTER(Error)()
        value = self._call(name, result, *arguments, ctypes.byref(error))
        if error:
            raise RuntimeError(f"{name}: {error.contents.message.decode()}")
        return value
