"""The galvo on a National Instruments card, through nidaqmx: hold, scan on the camera's strobe, park.

A retriggerable counter, started by the strobe, gives one burst of sample clocks per frame; the analog output repeats
the waveform from the card's own memory, so no buffer can run dry. A watch thread sees to it that the line never stands
on the bundle: strobe lost, underrun, or a hold that goes on too long, and the galvo is parked.
"""

from __future__ import annotations

import atexit
import contextlib
import threading
import time
from typing import TYPE_CHECKING, Any, Final, Self

from napari_elsplus.errors import DeviceError
from napari_elsplus.hardware.daq.output import CardSettings, Output

if TYPE_CHECKING:
    from collections.abc import Callable

    from napari_elsplus.hardware.scan.waveform import GalvoLimits, Waveform

WATCH_EVERY_S: Final = 0.02
"""Seconds between two checks of the card; chosen: a small part of the 0.5 s in which the galvo has to park."""
LOST_AFTER_FRAMES: Final = 6
LOST_AFTER_S: Final = 0.08
"""A strobe counts as lost when it is late by this many frames, and by so long at least."""


class DaqScanner:
    """The galvo behind a National Instruments card; see `napari_elsplus.hardware.protocols.Scanner`.

    Opening it parks the galvo. It parks on leaving the context, on `close`, and when the interpreter ends.

    Parameters
    ----------
    card : CardSettings
        Which card, and where to park.
    limits : GalvoLimits
        What may be put out.
    now_s : callable
        The clock by which strobes are awaited and holds are timed.

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
        self._fault: DeviceError | None = None
        self._waveform: Waveform | None = None
        self._park_v = self._volts = card.park_v
        self._seen, self._seen_at_s = 0, 0.0
        self._closing = threading.Event()
        self._output.put(card.park_v)
        self._watch = threading.Thread(target=self._keep_watch, name="galvo watch", daemon=True)
        self._watch.start()
        atexit.register(self.close)

    @property
    def ramps_begun(self) -> int:
        """Ramps that the card began since `scan`: one for every strobe that it saw."""
        with self._lock:
            if self._waveform is None:
                return 0
            return -(-self._output.samples_done() // self._waveform.samples_per_ramp)

    @property
    def park_v(self) -> float:
        """Where the galvo parks."""
        return self._park_v

    def park_at(self, volts: float) -> None:
        """Set the parking voltage; see :meth:`napari_elsplus.hardware.protocols.Scanner.park_at`."""
        self.limits.check(volts, "the parking position")
        with self._lock:
            parked = self._waveform is None and self._volts == self._park_v
            moves, self._park_v = parked and volts != self._park_v, volts
            if moves:
                self.park()

    def hold(self, volts: float) -> None:
        """Hold the line at a voltage; see :meth:`napari_elsplus.hardware.protocols.Scanner.hold`."""
        self.limits.check(volts)
        with self._lock:
            self._begin()
            self._go_to(volts)
            self._seen_at_s = self._now_s()

    def scan(self, waveform: Waveform) -> None:
        """Put the waveform out, one ramp after each strobe."""
        self.limits.check(waveform.volts, "the scan")
        with self._lock:
            self._begin()
            self._go_to(float(waveform.volts[0]))
            try:
                self._output.repeat(waveform)
            except DeviceError:
                self._try_to_park()
                raise
            self._waveform, self._seen, self._seen_at_s = waveform, 0, self._now_s()

    def check(self) -> None:
        """Raise what has gone wrong since the last `hold` or `scan`."""
        with self._lock:
            if self._fault is not None:
                raise self._fault

    def park(self) -> None:
        """Stop the scan and take the line off the bundle."""
        with self._lock:
            self._waveform, self._volts = None, self._park_v
            try:
                self._output.clear()
            finally:
                self._output.put(self._park_v)

    def close(self) -> None:
        """Park, and let the card go; does nothing the second time."""
        if self._closing.is_set():
            return
        self._closing.set()
        if threading.current_thread() is not self._watch:
            self._watch.join()
        with self._lock:
            self._try_to_park()
            with contextlib.suppress(DeviceError):  # the card is gone: there is nothing left to let go
                self._output.close()
        atexit.unregister(self.close)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *reason: object) -> Any:
        self.close()

    def _begin(self) -> None:
        if self._closing.is_set():
            raise DeviceError("the galvo was closed", "open the rig again")
        self._waveform, self._fault = None, None

    def _go_to(self, volts: float) -> None:
        """Move in steps that keep the slew limit, a millisecond each, then stand."""
        step = self.limits.max_slew_v_per_s * 1e-3
        try:
            while abs(volts - self._volts) > step:
                self._volts += step if volts > self._volts else -step
                self._output.put(self._volts)
                time.sleep(1e-3)
            self._output.put(volts)
        except DeviceError:
            self._try_to_park()
            raise
        self._volts = volts

    def _try_to_park(self) -> None:
        with contextlib.suppress(DeviceError):  # the first error is raised
            self.park()

    def _keep_watch(self) -> None:
        while not self._closing.wait(WATCH_EVERY_S):
            with self._lock:
                fault = self._fault_now()
                if fault is not None:
                    self._try_to_park()
                    self._fault = fault

    def _fault_now(self) -> DeviceError | None:
        if self._fault is not None:
            return None
        now = self._now_s()
        if self._waveform is None or self._seen == 0:
            stands = self._waveform is not None or self._volts != self._park_v
            if stands and now - self._seen_at_s > self.card.hold_limit_s:
                return DeviceError(
                    f"the line stood on one place for {self.card.hold_limit_s:g} s, so the galvo was parked",
                    "start again; the limit is hold_limit_s in the rig's file",
                )
        if self._waveform is None:
            return None
        try:
            done = self._output.samples_done()
        except DeviceError as error:
            return error
        if done != self._seen:
            self._seen, self._seen_at_s = done, now
        late = now - self._seen_at_s
        if self._seen and late > max(LOST_AFTER_S, LOST_AFTER_FRAMES * self._waveform.frame_period_s):
            return DeviceError(
                f"no strobe for {late * 1e3:.0f} ms, so the galvo was parked",
                f"check that the camera runs and that its strobe reaches {self.card.strobe}",
            )
        return None
