"""Any camera with a device adapter in Micro-Manager, by its maker's software, through pymmcore-plus (extra ``mmcore``).

Region, exposure and frames go by the functions that every adapter has. Frame rate and gain have none: they are
properties, whose names differ between adapters.
"""

from __future__ import annotations

import time
from contextlib import contextmanager, suppress
from math import ceil, inf
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from napari_elsplus.closing import ClosedOnExit
from napari_elsplus.errors import DeviceError, InputError
from napari_elsplus.hardware.limits import RATE_TOLERANCE, SensorLimits
from napari_elsplus.hardware.micro_manager.frame_count import CORE_NUMBER, FrameCount
from napari_elsplus.hardware.protocols import FrameInfo
from napari_elsplus.instrument.optics import LINE_RATE_HZ

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from numpy.typing import NDArray

    from napari_elsplus.hardware.protocols import Region

DEPTH: Final = 64
"""Frames that wait for their reader in MMCore, which discards all of them when there is no room; chosen: 0.27 s at
240 Hz, twice that of the USB3 Vision driver, which discards single frames."""
POLL_S: Final = 5e-4
"""Seconds between two looks for a frame; chosen: an eighth of the frame period at 240 Hz."""
MAX_ROUNDING: Final = 0.01
"""Relative difference of a property from the value that it was set to; chosen: cameras round frame rates to clock
cycles, and the rate that they hold is used."""


class MicroManagerCamera(ClosedOnExit):
    """A camera of Micro-Manager; see `napari_elsplus.hardware.protocols.Camera`.

    Parameters
    ----------
    config : str
        Path of the configuration file that Micro-Manager's wizard has written. It names the camera, and sets what only
        this camera has: 8-bit pixels, rolling shutter, an output that is active while the sensor is exposed.
    frame_rate : str
        Name of the camera's property that is its frame rate in Hz.
    gain : str
        Name of the property that is its gain in dB; empty: the gain cannot be set.
    frame_number : str
        Tag of the images by which the camera's frames are counted, where its adapter has one. That of MMCore counts
        what has reached the computer.
    folder : str
        Folder of Micro-Manager with the device adapters; empty: the one that pymmcore-plus finds.
    line_rate_hz : float
        Rows per second; there is no function for it.

    Raises
    ------
    DeviceError
        If the extra is not installed, or the configuration cannot be loaded, or holds no camera.
    """

    def __init__(
        self,
        config: str,
        frame_rate: str,
        *,
        gain: str = "",
        frame_number: str = CORE_NUMBER,
        folder: str = "",
        line_rate_hz: float = LINE_RATE_HZ,
    ) -> None:
        self._core = _load(config, folder)
        self._label = self._core.getCameraDevice()
        if not self._label:
            self._core.unloadAllDevices()
            raise DeviceError(f"{config} names no camera", "choose the default camera in Micro-Manager's wizard")
        self._rate_name, self._gain_name, self._number_tag = frame_rate, gain, frame_number
        self.line_period_s = 1 / line_rate_hz
        self._region: Region | None = None
        self._rate_hz = 0.0
        self._streams = False
        self._received = 0
        self._count = FrameCount(self._number_tag, self._rate_hz)

    @property
    def sensor(self) -> SensorLimits:
        """Size of the sensor; the region becomes the whole of it, and has to be set anew."""
        with _translate_errors():
            self._core.clearROI()
            return SensorLimits(self._core.getImageHeight(), self._core.getImageWidth(), 1, 1)

    @property
    def frame_rate_limits_hz(self) -> tuple[float, float]:
        """Limits of the property that is the frame rate, in Hz; where it states none, its value and infinity."""
        with _translate_errors():
            return self._limits(self._rate_name) or (self._value(self._rate_name), inf)

    @property
    def frame_shape(self) -> tuple[int, int]:
        """Rows and columns of a frame, as configured."""
        return self._configured().shape

    @property
    def line_periods_per_frame(self) -> float:
        """Line periods from one frame to the next, idle time included."""
        self._configured()
        return 1 / (self._rate_hz * self.line_period_s)

    @property
    def frames_received(self) -> int:
        """Frames that have reached MMCore since the camera was opened, unread ones included."""
        waiting = self._core.getRemainingImageCount() if self._streams else 0
        return int(self._received + self._count.in_core + waiting)

    @property
    def dropped(self) -> Mapping[str, int]:
        """Frames lost since `start`, by cause."""
        return dict(self._count.dropped)

    def configure(self, region: Region, *, slit_rows: int, frame_rate_hz: float, gain_db: float = 0.0) -> None:
        """Set the camera; see :meth:`napari_elsplus.hardware.protocols.Camera.configure`."""
        if self._streams:
            raise DeviceError("the camera streams", "stop it before changing its settings")
        if slit_rows < 1:
            raise InputError(f"a slit of {slit_rows} rows", "give at least 1")
        if gain_db and not self._gain_name:
            raise InputError(f"a gain of {gain_db:g} dB", "name the camera's property as gain in the rig's file")
        self._region = None
        with _translate_errors():
            self._set_region(region)
            self._set_exposure(slit_rows)
            self._rate_hz = self._set(self._rate_name, frame_rate_hz)
            if self._gain_name:
                self._set(self._gain_name, gain_db)
            bits = 8 * self._core.getBytesPerPixel()
        if bits != 8:
            raise DeviceError(f"the camera sends pixels of {bits} bits", "set 8 bits in Micro-Manager's configuration")
        self._region = region

    def start(self) -> None:
        """Begin to stream."""
        if self._streams:
            return
        rows, cols = self._configured().shape
        self._count = FrameCount(self._number_tag, self._rate_hz)
        with _translate_errors():
            self._core.setCircularBufferMemoryFootprint(ceil(DEPTH * rows * cols / (1 << 20)))
            self._core.startContinuousSequenceAcquisition(0)
        self._streams = True

    def read_into(self, buffer: NDArray[np.uint8], timeout_s: float) -> FrameInfo:
        """Fill a buffer with the oldest unread frame.

        See :meth:`napari_elsplus.hardware.protocols.Camera.read_into`.
        """
        if not self._streams:
            raise DeviceError("the camera does not stream", "start it first")
        shape = self.frame_shape
        if buffer.shape != shape or buffer.dtype != "uint8" or not buffer.flags.c_contiguous:
            raise InputError(f"a buffer of {buffer.shape} {buffer.dtype}", f"give {shape} uint8, C-contiguous")
        with _translate_errors():
            image, tags = self._oldest(time.perf_counter() + timeout_s)
            received_s, waiting = time.perf_counter(), self._core.getRemainingImageCount()
        if image.shape != shape:
            raise DeviceError(f"a frame of {image.shape} instead of {shape} pixels", "configure the camera again")
        np.copyto(buffer, image)
        number, time_s = self._count.add(tags, received_s, waiting)
        return FrameInfo(number, received_s, time_s)

    def stop(self) -> None:
        """End the stream; frames not read yet are discarded."""
        if not self._streams:
            return
        self._received, self._streams = self.frames_received, False
        self._count.in_core = 0
        with suppress(RuntimeError):  # it is gone: there is nothing to stop
            self._core.stopSequenceAcquisition()

    def close(self) -> None:
        """Stop, and release the camera."""
        self.stop()
        with suppress(RuntimeError):
            self._core.unloadAllDevices()

    def _configured(self) -> Region:
        if self._region is None:
            raise DeviceError("the camera was not configured", "configure it first")
        return self._region

    def _set_region(self, region: Region) -> None:
        """Set the region, and compare it with the one that the camera holds: adapters round, and some check nothing."""
        sensor, wanted = self.sensor, (region.col, region.row, region.cols, region.rows)
        if region.row + region.rows <= sensor.rows and region.col + region.cols <= sensor.cols:
            self._core.setROI(*wanted)
        if (held := tuple(self._core.getROI())) != wanted:
            raise InputError(
                f"a region of {region.rows} x {region.cols} at {region.row}, {region.col}",
                f"the camera holds {held[3]} x {held[2]} at {held[1]}, {held[0]} of {sensor.rows} x {sensor.cols}",
            )

    def _set_exposure(self, slit_rows: int) -> None:
        wanted_s = slit_rows * self.line_period_s
        self._core.setExposure(wanted_s * 1e3)
        held_s = self._core.getExposure() * 1e-3
        if abs(held_s - wanted_s) > self.line_period_s / 2:
            raise InputError(
                f"a slit of {slit_rows} rows, an exposure of {wanted_s * 1e6:.2f} us",
                f"the camera holds {held_s * 1e6:.2f} us, {held_s / self.line_period_s:.1f} rows",
            )

    def _set(self, name: str, value: float) -> float:
        """Set a property, and return the value that the camera holds."""
        low, high = self._limits(name) or (-inf, inf)
        if not low - RATE_TOLERANCE * abs(low) <= value <= high + RATE_TOLERANCE * abs(high):
            raise InputError(f"{name} = {value:.6g}", f"the camera allows {low:.6g} to {high:.6g}")
        self._core.setProperty(self._label, name, min(max(value, low), high))
        held = self._value(name)
        if abs(held - value) > MAX_ROUNDING * abs(value):
            raise InputError(f"{name} = {value:.6g}", f"the camera holds {held:.6g} in this region")
        return held

    def _limits(self, name: str) -> tuple[float, float] | None:
        core, label = self._core, self._label
        if not core.hasPropertyLimits(label, name):
            return None
        return core.getPropertyLowerLimit(label, name), core.getPropertyUpperLimit(label, name)

    def _value(self, name: str) -> float:
        text = self._core.getProperty(self._label, name)
        try:
            return float(text)
        except ValueError:
            raise DeviceError(f"the camera's {name} is {text!r}, no number", "name another property") from None

    def _oldest(self, until_s: float) -> tuple[NDArray[Any], Mapping[str, str]]:
        """Return the oldest image of MMCore and its tags, as soon as there is one."""
        core = self._core
        while True:
            runs = core.isSequenceRunning()
            if core.getRemainingImageCount():
                with suppress(IndexError):  # discarded meanwhile, to make room
                    image, tags = core.popNextImageAndMD()
                    return image, tags
            elif not runs:
                raise DeviceError("the camera has stopped", "check its cable, then open the rig again")
            elif time.perf_counter() >= until_s:
                raise TimeoutError("no frame came in time")
            else:
                time.sleep(POLL_S)


def _load(config: str, folder: str) -> Any:
    """Return a core of Micro-Manager with the devices of a configuration file."""
    try:
        from pymmcore_plus import CMMCorePlus
    except ImportError as error:
        raise DeviceError(
            "the mmcore extra is not installed, so no camera of Micro-Manager can be driven",
            "pip install 'napari-elsplus[mmcore]'",
        ) from error
    core = CMMCorePlus(folder or None)
    try:
        core.loadSystemConfiguration(config)
    except (OSError, RuntimeError) as error:
        core.unloadAllDevices()
        raise DeviceError(
            f"Micro-Manager cannot load {config} ({error})",
            "load it in Micro-Manager first, the camera plugged in",
        ) from error
    return core


@contextmanager
def _translate_errors() -> Iterator[None]:
    """Turn the errors of MMCore into a `DeviceError`.

    Raises
    ------
    DeviceError
        For every error of a device adapter.
    """
    try:
        yield
    except RuntimeError as error:
        raise DeviceError(f"Micro-Manager: {error}", "check the camera and its configuration file") from error
