"""A USB3 Vision camera: control, clock, stream, and the features of its make."""

from __future__ import annotations

import time
from math import inf
from typing import TYPE_CHECKING, Final, Protocol

from napari_elsplus.closing import ClosedOnExit
from napari_elsplus.errors import DeviceError, InputError
from napari_elsplus.hardware.u3v.control import MODEL, SERIAL, Control, RegisterError
from napari_elsplus.hardware.u3v.discovery import endpoints, refuse_slow_link, translate_usb_errors
from napari_elsplus.hardware.u3v.stream import U3vStream
from napari_elsplus.hardware.u3v.transfers import ENABLE, negotiate_transfers

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    import numpy as np
    from numpy.typing import NDArray
    from usb.core import Device

    from napari_elsplus.hardware.limits import SensorLimits
    from napari_elsplus.hardware.protocols import FrameInfo, Region

TIMESTAMP, LATCH, INCREMENT = 0x01F0, 0x01F8, 0x01FC
"""Bootstrap registers: latched time, latch, and nanoseconds per tick of the internal clock."""
NANOSECOND: Final = 1e-9
"""Seconds per tick that the standard requires."""
BASELINE_S: Final = 0.02
"""Seconds between the latches that measure a tick; chosen: a hundred times a register access."""
LONG_BASELINE_S: Final = 0.5
"""The same where the first shows no tick that is stated: a busy computer, or a tick that no register states; chosen: a
register access is then a thousandth of it."""
TOLERANCE: Final = 0.2
"""Relative error by which a measured tick may differ from a stated one; chosen: cameras' ticks differ by factors."""
LATCHES: Final = 3
"""Latches of which the tightest counts; chosen: an access that was held up, or sent again, does not count."""
INVALID_AFTER_CHANGE: Final = 2
"""Frames that are invalid after the region was changed; the maker's statement for another model of the series."""
MEASURED_FRAMES: Final = 12
"""Frames by which the bus is measured, of which the fastest counts; chosen: 50 ms at 240 Hz, in which a busy computer
reads at least one in time."""


class CameraClock:
    """Seconds per tick, and zero, of a camera's clock.

    Parameters
    ----------
    control : Control
        Control channel of the camera.

    Attributes
    ----------
    tick_s : float
        Seconds per tick, measured: 1 ns where the camera keeps to the standard.
    """

    def __init__(self, control: Control) -> None:
        self._control = control
        self._runs, self.tick_s = True, NANOSECOND
        try:
            self.tick_s = self._measure_tick()
        except RegisterError:
            self._runs = False

    def zero_s(self) -> float | None:
        """Return when the camera's clock was at zero, on the clock of `time.perf_counter`; None where it has none.

        Never later than the truth, and earlier by the time of one register access.
        """
        if not self._runs:
            return None
        return max(before_s - ticks * self.tick_s for before_s, ticks in (self._latch() for _ in range(LATCHES)))

    def _measure_tick(self) -> float:
        stated = (NANOSECOND, self._control.read_number(INCREMENT, 8) * NANOSECOND)
        for baseline_s in (BASELINE_S, LONG_BASELINE_S):
            tick_s = self._tick(baseline_s)
            near = [known for known in stated if abs(known - tick_s) < TOLERANCE * tick_s]
            if near:
                return near[0]
        return tick_s

    def _tick(self, baseline_s: float) -> float:
        """Return seconds per tick; a clock that stands counts as none."""
        begin_s, first = self._latch()
        time.sleep(baseline_s)
        end_s, last = self._latch()
        self._runs = last > first
        return (end_s - begin_s) / (last - first) if self._runs else NANOSECOND

    def _latch(self) -> tuple[float, int]:
        """Return the time before the latch, and the camera's time in ticks."""
        before_s = time.perf_counter()
        self._control.write_number(LATCH, 1)
        return before_s, self._control.read_number(TIMESTAMP, 8)


class Features(Protocol):
    """Features that differ between makes: how region, exposure, gain, rate and strobe are set."""

    @property
    def sensor(self) -> SensorLimits:
        """Size of the sensor, and its steps."""

    @property
    def frame_rate_limits_hz(self) -> tuple[float, float]:
        """Lowest and highest frame rate at the present region and exposure, in Hz."""

    @property
    def line_period_s(self) -> float:
        """Seconds per row, read from the camera or derived."""

    @property
    def frame_rate_hz(self) -> float:
        """Frame rate that the camera reports, in Hz."""

    def configure(self, region: Region, exposure_s: float, frame_rate_hz: float, gain_db: float) -> None:
        """Set the camera, with the strobe active while the sensor is exposed.

        Parameters
        ----------
        region : Region
            Part of the sensor that is read.
        exposure_s : float
            Exposure of each row in seconds.
        frame_rate_hz : float
            Frames per second.
        gain_db : float
            Gain in dB.
        """

    def reset(self) -> None:
        """Load the default settings, and switch off what would change the images: gamma, trigger, binning, chunks.

        Raises
        ------
        DeviceError
            Naming what cannot be switched off.
        """

    def start(self) -> None:
        """Begin to acquire."""

    def stop(self) -> None:
        """End acquiring; does nothing where the camera does not acquire."""


class U3vCamera(ClosedOnExit):
    """A USB3 Vision camera; see `napari_elsplus.hardware.protocols.Camera`.

    Parameters
    ----------
    device : usb.core.Device
        Camera on the bus.
    features : callable
        Called with the control channel, returns the `Features` of this make.
    wait_for_reader : bool
        Hold the camera up while the queue is full instead of dropping frames; only a simulated camera can wait.

    Raises
    ------
    DeviceError
        If it is on a USB 2 link, open elsewhere, may not be opened, or does not answer.
    """

    def __init__(
        self, device: Device, features: Callable[[Control], Features], *, wait_for_reader: bool = False
    ) -> None:
        from usb import util

        refuse_slow_link(device)
        self._device, self._wait = device, wait_for_reader
        self._ends = endpoints(device)
        self._stream: U3vStream | None = None
        self._region: Region | None = None
        self._streamed: Region | None = None
        self._dropped: Mapping[str, int] = {}
        self._rate_hz = 0.0
        self._clock_zero_s: float | None = None
        self._received = 0
        try:
            self._claim()
            self._control = Control(device, self._ends)
            self.model, self.serial = self._control.read_text(MODEL), self._control.read_text(SERIAL)
            self._features = features(self._control)
            self._end_earlier_session()
            self._clock = CameraClock(self._control)
        except BaseException:
            util.dispose_resources(device)
            raise

    @property
    def sensor(self) -> SensorLimits:
        """Size of the sensor, and the steps of a region, as the camera states them."""
        return self._features.sensor

    @property
    def frame_rate_limits_hz(self) -> tuple[float, float]:
        """Lowest and highest frame rate at the present region and exposure, in Hz, as the camera states them."""
        return self._features.frame_rate_limits_hz

    @property
    def carried_rate_hz(self) -> float | None:
        """Frames per second that the bus carries; see `napari_elsplus.hardware.limits.MeasuresBus`."""
        stream = self._stream
        if self._wait:
            return inf  # it waits for its reader, so that its rate is that of the reader
        if stream is None or stream.whole < MEASURED_FRAMES:
            return None
        return 1 / stream.shortest_payload_s

    @property
    def tick_s(self) -> float:
        """Seconds per unit of the camera's timestamps, measured: 1 ns by the standard."""
        return self._clock.tick_s

    @property
    def frame_shape(self) -> tuple[int, int]:
        """Rows and columns of a frame, as configured."""
        return self._configured().shape

    @property
    def line_period_s(self) -> float:
        """Seconds from the readout of one row to that of the next."""
        return self._features.line_period_s

    @property
    def line_periods_per_frame(self) -> float:
        """Line periods from one frame to the next, idle time included."""
        self._configured()
        return 1 / (self._rate_hz * self.line_period_s)

    @property
    def clock_zero_s(self) -> float | None:
        """Zero of the camera's clock on that of `time.perf_counter`; see `protocols.HasClock`."""
        stream = self._stream
        return self._clock_zero_s if stream is None or stream.has_timestamps else None

    @property
    def frames_received(self) -> int:
        """Frames that have reached this computer since the camera was opened, incomplete ones included."""
        stream = self._stream
        return self._received + (stream.received if stream else 0)

    @property
    def dropped(self) -> Mapping[str, int]:
        """Frames lost since `start`, by cause."""
        return dict(self._stream.dropped) if self._stream else self._dropped

    def configure(self, region: Region, *, slit_rows: int, frame_rate_hz: float, gain_db: float = 0.0) -> None:
        """Set the camera; see :meth:`napari_elsplus.hardware.protocols.Camera.configure`."""
        if self._stream is not None:
            raise DeviceError("the camera streams", "stop it before changing its settings")
        if slit_rows < 1:
            raise InputError(f"a slit of {slit_rows} rows", "give at least 1")
        self._region = None
        self._features.configure(region, slit_rows * self.line_period_s, frame_rate_hz, gain_db)
        self._region, self._rate_hz = region, self._features.frame_rate_hz

    def start(self) -> None:
        """Begin to stream."""
        if self._stream is not None:
            return
        region = self._configured()
        sizes = negotiate_transfers(self._control, region.shape)
        self._control.write_number(self._control.sirm + ENABLE, 1)
        self._stream = U3vStream(
            self._device,
            self._ends.stream_in,
            sizes,
            region.shape,
            timeout_s=0.5 + 2 / self._rate_hz,
            tick_s=self._clock.tick_s,
            period_s=1 / self._rate_hz,
            skip=INVALID_AFTER_CHANGE if region != self._streamed else 0,
            wait_for_reader=self._wait,
        )
        self._streamed = region
        try:
            self._features.start()
            self._clock_zero_s = self._clock.zero_s()
        except BaseException:
            self.stop()
            raise

    def read_into(self, buffer: NDArray[np.uint8], timeout_s: float) -> FrameInfo:
        """Fill a buffer with the oldest unread frame.

        See :meth:`napari_elsplus.hardware.protocols.Camera.read_into`.
        """
        if self._stream is None:
            raise DeviceError("the camera does not stream", "start it first")
        shape = self.frame_shape
        if buffer.shape != shape or buffer.dtype != "uint8" or not buffer.flags.c_contiguous:
            raise InputError(f"a buffer of {buffer.shape} {buffer.dtype}", f"give {shape} uint8, C-contiguous")
        return self._stream.read_into(buffer, timeout_s)

    def stop(self) -> None:
        """End the stream; frames not read yet are discarded."""
        stream = self._stream
        if stream is None:
            return
        try:
            self._features.stop()
            self._control.write_number(self._control.sirm + ENABLE, 0)
        except DeviceError:
            self._streamed = None  # unplugged, or as good as: the next start begins anew
        finally:
            stream.stop()
            self._dropped = dict(stream.dropped)
            self._received, self._stream = self._received + stream.received, None

    def close(self) -> None:
        """Stop, and release the camera."""
        from usb import util
        from usb.core import USBError

        self.stop()
        try:
            util.dispose_resources(self._device)
        except USBError:
            self._region = None  # gone: there is nothing left to let go

    def _configured(self) -> Region:
        if self._region is None:
            raise DeviceError("the camera was not configured", "configure it first")
        return self._region

    def _claim(self) -> None:
        from usb import util

        with translate_usb_errors("the camera"):
            self._device.get_active_configuration()
            for interface in (self._ends.control_interface, self._ends.stream_interface):
                if self._kernel_has(interface):
                    raise DeviceError("the camera is held by a driver of the system", "stop the program that uses it")
                util.claim_interface(self._device, interface)

    def _end_earlier_session(self) -> None:
        """End what a program that was killed has left: a camera goes on streaming, and locks its settings."""
        self._features.stop()
        self._control.write_number(self._control.sirm + ENABLE, 0)
        with translate_usb_errors("the camera"):
            self._device.clear_halt(self._ends.stream_in)
        self._features.reset()

    def _kernel_has(self, interface: int) -> bool:
        try:
            return bool(self._device.is_kernel_driver_active(interface))
        except NotImplementedError:  # not on this system
            return False
