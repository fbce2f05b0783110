"""Protocols of a camera and of a scanner.

Anything that implements these two can be driven: the USB3 Vision camera and the National Instruments card of this
package, their virtual counterparts, or a driver of the user's own.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol, Self, runtime_checkable

from napari_elsplus.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    import numpy as np
    from numpy.typing import NDArray

    from napari_elsplus.hardware.parking import ParkState
    from napari_elsplus.hardware.scan.waveform import Waveform


@dataclass(frozen=True, slots=True)
class Region:
    """The part of the sensor that is read.

    Parameters
    ----------
    row, col : int
        First sensor pixel.
    rows, cols : int
        Size.

    Raises
    ------
    InputError
        If it is empty or begins outside the sensor.
    """

    row: int
    col: int
    rows: int
    cols: int

    def __post_init__(self) -> None:
        if min(self.row, self.col) < 0 or min(self.rows, self.cols) < 1:
            raise InputError(
                f"a camera region of {self.rows} x {self.cols} at {self.row}, {self.col}",
                "it must begin on the sensor and hold at least one pixel",
            )

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of a frame."""
        return self.rows, self.cols


@dataclass(frozen=True, slots=True)
class FrameInfo:
    """Number and times of a frame.

    Parameters
    ----------
    frame_number : int
        The camera's own count since `Camera.start`; a jump by more than one means that frames are missing.
    received_s : float
        When the frame's last byte reached this computer, on the clock of `time.perf_counter`.
    readout_start_s : float
        When its first row was read, on the camera's clock: even spacing, arbitrary zero.
    """

    frame_number: int
    received_s: float
    readout_start_s: float


@runtime_checkable
class Camera(Protocol):
    """A rolling-shutter camera. A context manager: leaving it stops and closes the camera."""

    @property
    def frame_shape(self) -> tuple[int, int]:
        """Rows and columns of a frame, as configured."""

    @property
    def line_period_s(self) -> float:
        """Seconds from the readout of one row to that of the next."""

    @property
    def line_periods_per_frame(self) -> float:
        """Line periods from one frame to the next, idle time included."""

    @property
    def dropped(self) -> Mapping[str, int]:
        """Frames lost since `start`, by cause."""

    def configure(self, region: Region, *, slit_rows: int, frame_rate_hz: float, gain_db: float = 0.0) -> None:
        """Set region, exposure, frame rate and gain; switch the strobe output on.

        Parameters
        ----------
        region : Region
            Part of the sensor that is read.
        slit_rows : int
            Exposure in line periods, which is the width of the rolling slit in rows.
        frame_rate_hz : float
            Frames per second.
        gain_db : float
            Gain in dB.

        Raises
        ------
        InputError
            If the camera cannot do that; the message contains its limit.
        DeviceError
            If the camera is streaming, or does not answer.
        """

    def start(self) -> None:
        """Start streaming.

        Raises
        ------
        DeviceError
            If the camera does not answer, or was not configured.
        """

    def read_into(self, buffer: NDArray[np.uint8], timeout_s: float) -> FrameInfo:
        """Fill the caller's buffer with the oldest unread frame.

        Parameters
        ----------
        buffer : numpy.ndarray
            C-contiguous uint8 of `frame_shape`; written only when the call succeeds.
        timeout_s : float
            Time to wait for a frame.

        Raises
        ------
        TimeoutError
            If no frame came in time; the camera still streams.
        DeviceError
            If the camera was unplugged or failed; the stream has ended.
        """

    def stop(self) -> None:
        """End the stream; unread frames are discarded. Does nothing if the camera does not stream."""

    def close(self) -> None:
        """Stop, and release the camera. Never raises because the camera is gone."""

    def __enter__(self) -> Self:
        """Return the camera."""

    def __exit__(self, *reason: object) -> Any:
        """Close the camera."""


@runtime_checkable
class CountsFrames(Protocol):
    """A camera that counts frames; `open_rig` passes the count to the scanner's interlocks."""

    @property
    def frames_received(self) -> int:
        """Frames that have reached this computer since the camera was opened, incomplete ones included."""


@runtime_checkable
class HasClock(Protocol):
    """A camera whose clock can be read, so that the time of a frame's exposure is known."""

    @property
    def clock_zero_s(self) -> float | None:
        """When the clock of `FrameInfo.readout_start_s` was at zero, in seconds on that of `time.perf_counter`.

        Measured by `Camera.start`, never later than the truth; None where the camera's clock cannot be read, or the
        frames are not timed by it. Valid from the first frame on.
        """


@runtime_checkable
class Scanner(Protocol):
    """The galvo that positions the laser line. A context manager: leaving it parks and releases the galvo.

    A scanner watches itself: after a fault (strobe lost or never wired, no frames, underrun, a hold that is too long)
    it has stopped and parks, and `check` raises the fault until the next `hold` or `scan`. An attempt to park that
    fails is repeated without end.
    """

    @property
    def ramps_begun(self) -> int:
        """Ramps that the card began since `scan`: one for every strobe that it detected."""

    @property
    def park_v(self) -> float:
        """Voltage at which the galvo parks: the rig's, until `park_at` sets another."""

    @property
    def park_state(self) -> ParkState:
        """State of parking; `ParkState.parked` only after the card has confirmed it. Read without any lock."""

    def on_park_state(self, callback: Callable[[ParkState], None]) -> Callable[[], None]:
        """Call `callback` with every new state of parking, in a thread of the scanner; return what ends it."""

    def watch_frames(self, received: Callable[[], int] | None) -> None:
        """Use a count of received frames to park when frames come without ramps, or ramps without frames.

        Parameters
        ----------
        received : callable, optional
            Returns the number of frames that the camera has delivered, lost ones included; must not block. None: no
            count, so only strobes and holds are watched.
        """

    def park_at(self, volts: float) -> None:
        """Set the parking voltage; a parked galvo moves there at once.

        Parameters
        ----------
        volts : float
            Drive in volts.

        Raises
        ------
        InputError
            If the voltage is outside the rig's limits, or on the bundle that is scanned; the one before stays.
        DeviceError
            If the card does not confirm the new position; parking is retried.
        """

    def hold(self, volts: float) -> None:
        """Hold the line at a voltage; after the rig's time limit the galvo parks by itself.

        Parameters
        ----------
        volts : float
            Drive in volts.

        Raises
        ------
        InputError
            If the voltage is outside the rig's limits; nothing was put out.
        DeviceError
            If the card fails, the galvo is not parked after a fault, or another thread parks it meanwhile.
        """

    def scan(self, waveform: Waveform) -> None:
        """Put the waveform out, one ramp after each strobe, until the next call.

        Raises
        ------
        InputError
            If the waveform leaves the rig's limits, or sweeps over the parking voltage; nothing was put out.
        DeviceError
            As `hold`.
        """

    def check(self) -> None:
        """Raise what has gone wrong since the last `hold` or `scan`.

        Raises
        ------
        DeviceError
            Strobe lost or never detected, no frames, underrun, card gone, or a hold that was too long; the galvo was
            parked, or `park_state` shows that it is not.
        """

    def park(self) -> None:
        """Stop the scan and take the line off the bundle; returns once the card has confirmed it.

        May be called from any thread at any time, also while another one is inside `hold`, `scan` or `close`: it
        waits for none of them, and they raise.

        Raises
        ------
        DeviceError
            If the card has not confirmed within 1.5 s; the message begins with "NOT PARKED", and parking is retried
            without end.
        """

    def close(self) -> None:
        """Park, and release the card once it is parked. Never raises; see `park_state` for what it achieved."""

    def __enter__(self) -> Self:
        """Return the scanner."""

    def __exit__(self, *reason: object) -> Any:
        """Park and close."""
