"""The galvo on a National Instruments card, through nidaqmx: hold, scan on the camera's strobe, park.

A retriggerable counter, started by the strobe, gives one burst of sample clocks per frame; the analog output repeats
the waveform from the card's own memory, so no buffer can run dry. The card's thread makes all calls: commands, and
between them it checks the interlocks, compares the parked output with the parking voltage, and parks: after a fault,
on command, and again until the card has confirmed it.
"""

from __future__ import annotations

import atexit
import contextlib
import threading
import time
import traceback
from typing import TYPE_CHECKING, Final, NamedTuple, TypeVar

from napari_elsplus.closing import ClosedOnExit
from napari_elsplus.errors import DeviceError
from napari_elsplus.hardware.daq.calls import CardThread
from napari_elsplus.hardware.daq.interlock import Interlock
from napari_elsplus.hardware.daq.output import CardSettings, Output
from napari_elsplus.hardware.parking import Parking, ParkStage, ParkState
from napari_elsplus.hardware.scan.clearance import check_parking_while_scanning

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from napari_elsplus.hardware.scan.waveform import GalvoLimits, Waveform

Result = TypeVar("Result")

WATCH_EVERY_S: Final = 0.04
"""Seconds between two checks of the card; chosen: half of the shortest time after which a strobe counts as lost, and a
small part of the 0.5 s in which the galvo has to park."""
COMPARE_EVERY_S: Final = 0.2
"""Seconds between two checks of the parked output; chosen: parked again within 0.5 s, at a hundredth of the card's
time (a check takes some calls, 1 to 2 ms)."""
PARK_TIMEOUT_S: Final = 1.5
"""Seconds that `DaqScanner.park` waits for the card; chosen: no call takes longer than 2 s."""
FAILING_TIMEOUT_S: Final = 0.3
"""Seconds that `DaqScanner.close` waits where parking has failed before; chosen: some attempts."""
CLOSE_TIMEOUT_S: Final = 1.9
"""Seconds that `DaqScanner.close` waits for the end of its threads; chosen: no call takes longer than 2 s."""


class ResetResult(NamedTuple):
    """Effect of a reset of the card on its output."""

    reset_s: float
    """Seconds that the reset took."""
    volts: float | None
    """Voltage read back after it; None where the card cannot."""
    parked_s: float
    """Seconds from the beginning of the reset to the write of the parking voltage."""


class DaqScanner(ClosedOnExit):
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
    takes_over : bool
        Park whoever has the card, by resets and without end; it returns at once, see `park_state`.

    Raises
    ------
    InputError
        If the parking voltage lies outside the limits.
    DeviceError
        If the driver is missing, the card is unknown, in use or gone.
    """

    def __init__(
        self,
        card: CardSettings,
        limits: GalvoLimits,
        now_s: Callable[[], float] = time.perf_counter,
        *,
        takes_over: bool = False,
    ) -> None:
        limits.check(card.park_v, "the parking position")
        self.card, self.limits = card, limits
        self._output, self._now_s = Output(card, limits), now_s
        self._parking = Parking(self._output, card.park_v)
        self._interlock = Interlock(card)
        self.hold_limit_s = card.hold_limit_s
        """Seconds after which a line that is held still is parked."""
        self.check_guarded: Callable[[], None] = lambda: None
        """Raises while no guardian is on guard; called before every hold and scan."""
        self._frames: Callable[[], int] | None = None
        self._fault: DeviceError | None = None
        self._waveform: Waveform | None = None
        self._volts = card.park_v
        self._parks = threading.Event()
        """Set from the command to park until the card has confirmed it; hold and scan give way to it."""
        self._parkings = 0
        """Number of commands to park; a hold or scan that was given before one of them does not move the galvo."""
        self._tasks_lost = threading.Event()
        self._closing = False
        self._compare_s = 0.0
        self._card = CardThread(self._output.calls, self._turn, self._failed, self._output.release, self._go_around)
        if takes_over:
            self._command_parking()
        self._card.start()
        try:
            if not takes_over:
                self._card.execute(self._first_attempt)
        except BaseException:
            self._closing = True
            self._card.wake()
            self._card.join(CLOSE_TIMEOUT_S)
            raise
        atexit.register(self.close)

    @property
    def ramps_begun(self) -> int:
        """Ramps that the card began since `scan`: one for every strobe that it detected."""
        return self._card.execute(self._count_ramps)

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
        self._refuse_if_closed()
        check_parking_while_scanning(volts, self._waveform)
        changed = volts != self._parking.volts
        self._parking.retarget(volts)
        if changed and self._parking.state.stage is not ParkStage.DRIVEN:
            self.park()

    def hold(self, volts: float) -> None:
        """Hold the line at a voltage; see :meth:`napari_elsplus.hardware.protocols.Scanner.hold`."""
        self.limits.check(volts)
        self._drive(lambda: self._hold(volts))

    def scan(self, waveform: Waveform) -> None:
        """Put the waveform out, one ramp after each strobe."""
        self.limits.check(waveform.volts, "the scan")
        check_parking_while_scanning(self.park_v, waveform)
        self._drive(lambda: self._scan(waveform))

    def check(self) -> None:
        """Raise what has gone wrong since the last `hold` or `scan`."""
        if (fault := self._fault) is not None:
            raise fault

    def park(self) -> None:
        """Stop the scan and take the line off the bundle; returns once the card has confirmed it."""
        self._command_parking()
        if not (state := self._parking.wait(PARK_TIMEOUT_S)).parked:
            raise DeviceError(state.message, "free the card, and check its cable")

    def try_reset(self) -> ResetResult:
        """Reset the card, and park; return what the reset did to the output. The laser has to be off.

        Raises
        ------
        DeviceError
            If the card fails, or does not confirm.
        """
        result = self._drive(self._reset)
        self.park()
        return result

    def interrupt(self, fault: DeviceError) -> None:
        """Park because of a fault that was found elsewhere; `check` raises it. Returns at once."""
        self._fault = fault
        self._tasks_lost.set()  # another process may have taken them
        self._command_parking()

    def close(self) -> None:
        """Park, and release the card once it is parked; does nothing the second time."""
        if self._closing:
            return
        begun_s = time.perf_counter()
        fails = self._parking.state.stage is ParkStage.NOT_PARKED
        self._command_parking()
        self._closing = True
        if self._parking.wait(FAILING_TIMEOUT_S if fails else PARK_TIMEOUT_S).parked:  # else parking goes on
            self._card.join(max(0.0, begun_s + CLOSE_TIMEOUT_S - time.perf_counter()))
        atexit.unregister(self.close)

    # what drives the galvo, in the card's thread

    def _drive(self, move: Callable[[], Result]) -> Result:
        """Move the galvo, unless parking is commanded before or meanwhile; whatever goes wrong parks it."""
        self._refuse_while_parking()
        self.check_guarded()
        commanded = self._parkings

        def in_turn() -> Result:
            self._refuse_while_parking(commanded)
            with self._driving():
                return move()

        return self._card.execute(in_turn)

    def _hold(self, volts: float) -> None:
        self._go_to(volts)
        self._output.laser(True)
        self._interlock.hold(self._now_s())

    def _scan(self, waveform: Waveform) -> None:
        self._go_to(float(waveform.volts[0]))
        self._output.repeat(waveform)
        self._output.laser(True)
        self._waveform = waveform
        self._interlock.scan(waveform, self._now_s(), self._count_frames())

    def _reset(self) -> ResetResult:
        self._output.laser_off()
        begun_s = time.perf_counter()
        self._output.reset()
        reset_s = time.perf_counter() - begun_s
        volts = self._output.read_back()
        self._output.put(self.park_v)
        return ResetResult(reset_s, volts, time.perf_counter() - begun_s)

    @contextlib.contextmanager
    def _driving(self) -> Iterator[None]:
        self._drop_lost_tasks()
        self._waveform, self._fault = None, None
        self._parking.begin(ParkStage.DRIVEN)
        try:
            yield
            self._refuse_while_parking()
        except BaseException:
            self._command_parking()
            raise

    def _refuse_while_parking(self, commanded: int | None = None) -> None:
        """Raise while parking is commanded, or was since a number of parkings had been `commanded`."""
        self._refuse_if_closed()
        if self._parks.is_set() or commanded not in (None, self._parkings):
            state = self._parking.state
            raise DeviceError(state.message or "the galvo is being parked", "start again when it is parked")

    def _refuse_if_closed(self) -> None:
        if self._closing:
            raise DeviceError("the galvo was closed", "open the rig again")

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

    # parking, and what commands it

    def _command_parking(self) -> None:
        if self._closing and self._parking.state.parked:
            return  # for good: nothing moves it any more, and nobody would park it again
        self._parkings += 1
        self._parking.begin(ParkStage.PARKING)  # before: the attempt may be over at once, and its state is the last
        self._parks.set()
        self._card.wake()

    def _turn(self) -> float | None:
        """Check or park, between commands; return the seconds until the next turn, None at the end."""
        if self._closing and not self._parks.is_set():
            return None
        if not self._parks.is_set():
            fault = self._fault_now()  # after a fault, too: it is parked then, and has to stay so
            self._fault = self._fault or fault
        if self._parks.is_set():
            self._attempt()
        return self._parking.state.retry_s if self._parks.is_set() else WATCH_EVERY_S

    def _failed(self, error: BaseException) -> float:
        """Park after a defect, without checking anything before; return the seconds until then."""
        self._parks.set()
        if isinstance(error, DeviceError):
            self._fault = error
        else:
            what = traceback.format_exception_only(error)[-1].strip()  # also of one whose text cannot be made
            self._fault = DeviceError(f"the galvo's watch failed ({what})", "report this, open the rig again")
        return self._parking.state.retry_s

    def _attempt(self) -> None:
        self._waveform = None
        self._drop_lost_tasks()
        self._parks.clear()  # before: it may be commanded again meanwhile
        if self._parking.attempt().parked:
            self._volts = self._parking.volts
            self._interlock.rest()
        else:
            self._parks.set()

    def _drop_lost_tasks(self) -> None:
        if self._tasks_lost.is_set():
            self._tasks_lost.clear()
            with contextlib.suppress(DeviceError):  # they ended with the reset
                self._output.clear()

    def _fault_now(self) -> DeviceError | None:
        try:
            self._compare_still()
            samples = self._output.samples_done() if self._waveform is not None else 0
        except DeviceError as error:
            fault: DeviceError | None = error
            self._tasks_lost.set()  # with a reset by another program, for instance
        else:
            fault = self._interlock.fault(self._now_s(), samples, self._count_frames())
        if fault is not None:
            self._command_parking()
        return fault

    def _compare_still(self) -> None:
        """Raise if a line that is parked or held does not stand any more where it was put: it is parked, again."""
        now_s, stage = time.perf_counter(), self._parking.state.stage
        still = {ParkStage.PARKED: "parked", ParkStage.DRIVEN: "held"}.get(stage)
        if still is None or self._waveform is not None or now_s < self._compare_s:
            return
        self._compare_s = now_s + COMPARE_EVERY_S
        try:
            self._output.check_still(self._volts)
        except DeviceError as error:
            self._parking.revoke(error.problem)
            with contextlib.suppress(DeviceError):  # its tasks may be gone
                self._output.clear()
            raise DeviceError(
                f"the {still} galvo was moved from elsewhere ({error.problem}), so it was parked",
                "end other programs that use the card, and check its cable",
            ) from error

    def _count_frames(self) -> int | None:
        return None if self._frames is None else self._frames()

    def _count_ramps(self) -> int:
        if self._waveform is None:
            return 0
        return -(-self._output.samples_done() // self._waveform.samples_per_ramp)

    def _first_attempt(self) -> None:
        """Park; a card that refuses twice is left to whoever drives it, and the error says that nothing was parked."""
        if self._parking.attempt().parked:
            return
        try:
            self._output.put(self.park_v)
        except DeviceError as error:
            raise DeviceError(f"{error.problem}; the galvo was not parked", error.remedy) from error
        if not self._parking.attempt().parked:
            self._parks.set()

    def _go_around(self, call: int) -> bool:
        """Reset the card and park it by tasks of its own while a call does not return; return True if it is parked."""
        output = Output(self.card, self.limits)
        parking = Parking(output, self.park_v)
        try:
            while not parking.state.parked:
                with self._output.calls.resetting_around(call) as stuck:
                    if not stuck:
                        return False
                    self._tasks_lost.set()
                    problem = "a call to the card did not return, so the card was reset and the galvo parked"
                    self._fault = self._fault or DeviceError(problem, "check its cable, then start again")
                    self._command_parking()
                    self._parking.alarm("a call to the card does not return")
                    state = parking.attempt(stuck=True)
                time.sleep(state.retry_s)
        finally:
            output.release()
        return True
