"""The galvo on a National Instruments card, through nidaqmx: hold, scan on the camera's strobe, park.

A retriggerable counter, started by the strobe, gives one burst of sample clocks per frame; the analog output repeats
the waveform from the card's own memory, so no buffer can run dry. A thread checks the interlocks and parks: after a
fault, on command, and again until the card has confirmed it.
"""

from __future__ import annotations

import atexit
import contextlib
import math
import threading
import time
from typing import TYPE_CHECKING, Any, Final, Self

from napari_elsplus.errors import DeviceError, InputError
from napari_elsplus.hardware.daq.interlock import Interlock
from napari_elsplus.hardware.daq.output import CardSettings, Output
from napari_elsplus.hardware.parking import Parking, ParkStage, ParkState

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from napari_elsplus.hardware.scan.waveform import GalvoLimits, Waveform

WATCH_EVERY_S: Final = 0.02
"""Seconds between two checks of the card; chosen: a small part of the 0.5 s in which the galvo has to park."""
PARK_TIMEOUT_S: Final = 1.5
"""Seconds that `DaqScanner.park` waits for the card; chosen: no call takes longer than 2 s."""
BYPASS_AFTER_S: Final = 0.5
"""Seconds without a call returning after which parking goes around it; chosen: far above a call's time."""
STUCK_AFTER_S: Final = 2.5
"""Seconds without a check of the card after which `check` is a fault; chosen: above the time limit of a call."""


class DaqScanner:
    """The galvo behind a National Instruments card; see `napari_elsplus.hardware.protocols.Scanner`.

    Opening it parks the galvo. It parks on leaving the context, on `close`, and when the interpreter ends.

    Parameters
    ----------
    card : CardSettings
        Card, wiring and parking voltage.
    limits : GalvoLimits
        Limits of the output.
    now_s : callable
        Clock by which strobes are awaited and holds are timed.

    Raises
    ------
    InputError
        If the parking voltage lies outside the limits.
    DeviceError
        If the driver is missing, the card is unknown, in use or gone.
    """

    def __init__(self, card: CardSettings, limits: GalvoLimits, now_s: Callable[[], float] = time.perf_counter) -> None:
        limits.check(card.park_v, "the parking position")
        self.card, self.limits = card, limits
        self._output, self._now_s = Output(card, limits), now_s
        self._lock = threading.RLock()
        """Held for calls to the card; `park` waits for it in no thread but the scanner's own."""
        self._parking = Parking(self._output, card.park_v)
        self._interlock = Interlock(card)
        self.hold_limit_s = card.hold_limit_s
        """Seconds after which a line that is held still is parked."""
        self._frames: Callable[[], int] | None = None
        self._fault: DeviceError | None = None
        self._waveform: Waveform | None = None
        self._volts = card.park_v
        self._parks = threading.Event()
        """Set from the command to park until the card has confirmed it; hold and scan give way to it."""
        self._tasks_lost = threading.Event()
        self._wake = threading.Event()
        self._closing = False
        self._alive_s = time.perf_counter()
        self._first_attempt()
        self._watch = threading.Thread(target=self._run, name="galvo watch", daemon=True)
        self._watch.start()
        atexit.register(self.close)

    @property
    def ramps_begun(self) -> int:
        """Ramps that the card began since `scan`: one for every strobe that it detected."""
        with self._lock:
            if self._waveform is None:
                return 0
            return -(-self._output.samples_done() // self._waveform.samples_per_ramp)

    @property
    def park_v(self) -> float:
        """Parking voltage."""
        return self._parking.volts

    @property
    def park_state(self) -> ParkState:
        """State of parking."""
        return self._parking.state

    def on_park_state(self, callback: Callable[[ParkState], None]) -> Callable[[], None]:
        """Call `callback` with every new state of parking; return what ends it."""
        return self._parking.subscribe(callback)

    def watch_frames(self, received: Callable[[], int] | None) -> None:
        """Use a count of received frames; see :meth:`napari_elsplus.hardware.protocols.Scanner.watch_frames`."""
        self._frames = received

    def park_at(self, volts: float) -> None:
        """Set the parking voltage; see :meth:`napari_elsplus.hardware.protocols.Scanner.park_at`."""
        self.limits.check(volts, "the parking position")
        changed = volts != self._parking.volts
        self._parking.retarget(volts)
        if changed and self._parking.state.stage is not ParkStage.DRIVEN:
            self.park()

    def hold(self, volts: float) -> None:
        """Hold the line at a voltage; see :meth:`napari_elsplus.hardware.protocols.Scanner.hold`."""
        self.limits.check(volts)
        with self._driving():
            self._go_to(volts)
            self._output.laser(True)
            self._interlock.hold(self._now_s())

    def scan(self, waveform: Waveform) -> None:
        """Put the waveform out, one ramp after each strobe."""
        self.limits.check(waveform.volts, "the scan")
        self._refuse_parking_on_the_bundle(waveform)
        with self._driving():
            self._go_to(float(waveform.volts[0]))
            self._output.repeat(waveform)
            self._output.laser(True)
            self._waveform = waveform
            self._interlock.scan(waveform, self._now_s(), self._count_frames())

    def check(self) -> None:
        """Raise what has gone wrong since the last `hold` or `scan`."""
        silent_s = time.perf_counter() - self._alive_s
        if self._fault is None and silent_s > STUCK_AFTER_S and not self._closing:
            self.interrupt(DeviceError(f"the card has not answered for {silent_s:.1f} s", "check its cable"))
            self._parking.alarm("the card does not answer")
        fault = self._fault
        if fault is not None:
            raise fault

    def park(self) -> None:
        """Stop the scan and take the line off the bundle; returns once the card has confirmed it."""
        self._command_parking()
        begun_s = time.perf_counter()
        bypassed = False
        while not self._parking.wait(WATCH_EVERY_S):
            now_s = time.perf_counter()
            if now_s - begun_s > PARK_TIMEOUT_S:
                self._parking.alarm("the card has not confirmed it")
                raise DeviceError(self._parking.state.message, "free the card, and check its cable")
            if not bypassed and now_s - max(begun_s, self._alive_s, self._output.returned_s) > BYPASS_AFTER_S:
                bypassed = True
                with contextlib.suppress(RuntimeError):  # no thread starts while the interpreter ends
                    threading.Thread(target=self._bypass, name="galvo parking", daemon=True).start()

    def interrupt(self, fault: DeviceError) -> None:
        """Park because of a fault that was found elsewhere; `check` raises it. Returns at once."""
        self._fault = fault
        self._command_parking()

    def close(self) -> None:
        """Park, and release the card once it is parked; does nothing the second time."""
        if self._closing:
            return
        self._command_parking()
        self._closing = True
        with contextlib.suppress(DeviceError):  # see park_state; parking goes on
            self.park()
        if self._parking.state.parked and threading.current_thread() is not self._watch:
            self._watch.join()
        atexit.unregister(self.close)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *reason: object) -> Any:
        self.close()

    # what drives the galvo

    @contextlib.contextmanager
    def _driving(self) -> Iterator[None]:
        """Hold the lock while the galvo is moved; whatever goes wrong parks it."""
        with self._lock:
            self._refuse_while_parking()
            self._drop_lost_tasks()
            self._waveform, self._fault = None, None
            self._parking.begin(ParkStage.DRIVEN)
            try:
                yield
                self._refuse_while_parking()
            except BaseException:
                self._command_parking()
                raise

    def _refuse_while_parking(self) -> None:
        if self._closing:
            raise DeviceError("the galvo was closed", "open the rig again")
        if self._parks.is_set():
            state = self._parking.state
            raise DeviceError(state.message or "the galvo is being parked", "start again when it is parked")

    def _refuse_parking_on_the_bundle(self, waveform: Waveform) -> None:
        low, high = waveform.exposed_v or (math.inf, -math.inf)
        if low <= self.park_v <= high:
            raise InputError(
                f"the parking voltage {self.park_v:.4g} V is on the bundle, scanned from {low:.4g} to {high:.4g} V",
                "choose park_v off the bundle, in the rig's file or the calibration",
            )

    def _go_to(self, volts: float) -> None:
        """Move in steps that keep the slew limit, a millisecond each, then stand."""
        step = self.limits.max_slew_v_per_s * 1e-3
        while abs(volts - self._volts) > step:
            self._refuse_while_parking()
            self._volts += step if volts > self._volts else -step
            self._output.put(self._volts)
            time.sleep(1e-3)
        self._output.put(volts)
        self._volts = volts

    # the scanner's own thread

    def _command_parking(self) -> None:
        self._parks.set()
        self._parking.begin(ParkStage.PARKING)
        self._wake.set()

    def _run(self) -> None:
        while True:
            self._wake.wait(self._parking.state.retry_s if self._parks.is_set() else WATCH_EVERY_S)
            self._wake.clear()
            self._alive_s = time.perf_counter()
            if self._closing and not self._parks.is_set():
                break
            try:
                with self._lock:
                    self._check_or_park()
            except Exception as error:  # noqa: BLE001 - this thread must not end
                self._fault = _as_fault(error)
                self._parks.set()
        with self._lock:
            self._output.release()

    def _check_or_park(self) -> None:
        if not self._parks.is_set():
            self._fault = self._fault or self._fault_now()
        if self._parks.is_set():
            self._attempt()

    def _attempt(self) -> None:
        self._waveform = None
        self._drop_lost_tasks()
        if self._parking.attempt().parked:
            self._volts = self._parking.volts
            self._interlock.rest()
            self._parks.clear()

    def _drop_lost_tasks(self) -> None:
        if self._tasks_lost.is_set():
            self._tasks_lost.clear()
            with contextlib.suppress(DeviceError):  # they ended with the reset
                self._output.clear()

    def _fault_now(self) -> DeviceError | None:
        try:
            samples = self._output.samples_done() if self._waveform is not None else 0
        except DeviceError as error:
            fault: DeviceError | None = error
        else:
            fault = self._interlock.fault(self._now_s(), samples, self._count_frames())
        if fault is not None:
            self._command_parking()
        return fault

    def _count_frames(self) -> int | None:
        return None if self._frames is None else self._frames()

    def _first_attempt(self) -> None:
        """Park, once; a card that cannot be driven at all is refused."""
        try:
            self._output.put(self.park_v)
        except DeviceError:
            self._output.release()
            raise
        if not self._parking.attempt().parked:
            self._parks.set()

    def _bypass(self) -> None:
        """Reset the card and park it by tasks of its own while another thread is stuck in a call."""
        if self._parking.state.parked:  # the call has returned meanwhile
            return
        problem = "a call to the card did not return, so the card was reset and the galvo parked"
        self._fault = self._fault or DeviceError(problem, "check its cable, then start again")
        self._tasks_lost.set()
        output = Output(self.card, self.limits)
        with contextlib.suppress(DeviceError):
            output.reset()
            output.put(self.park_v)
            output.confirm(self.park_v)
        output.release()
        self._parks.set()  # by the scanner's own tasks once more, those before the reset are gone
        self._wake.set()


def _as_fault(error: Exception) -> DeviceError:
    if isinstance(error, DeviceError):
        return error
    return DeviceError(f"the galvo's watch failed ({type(error).__name__}: {error})", "report this, open the rig again")
