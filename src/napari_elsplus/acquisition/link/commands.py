"""The commands of the engine's process: one typed table, from which server and client derive.

Each command is written once, as the function that the engine's process executes. A client that inherits `Commands` has
a method of that name with the same parameters, which returns a future of the result.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from functools import partial
from typing import TYPE_CHECKING, Any, Concatenate, Final, Generic, ParamSpec, Protocol, Self, TypeVar, overload

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from concurrent.futures import Future

    import numpy as np
    from numpy.typing import NDArray

    from napari_elsplus.acquisition.calibrating.whole import Target
    from napari_elsplus.acquisition.engine.live_images import LiveView
    from napari_elsplus.acquisition.engine.status import Settings
    from napari_elsplus.acquisition.link.session import Session
    from napari_elsplus.acquisition.streaming.recorder import RecordingPlan
    from napari_elsplus.acquisition.streaming.tally import Latencies
    from napari_elsplus.acquisition.streaming.usage import Usage
    from napari_elsplus.errors import MeasurementError
    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.processing.calibration.calibrate import Background, BundlePair, Findings, SlitOffset
    from napari_elsplus.processing.calibration.draft import Flat, LitPair, Setup
    from napari_elsplus.processing.calibration.galvo import GalvoMap
    from napari_elsplus.processing.calibration.lag import ScanLag
    from napari_elsplus.workflows.mosaic_plan import MosaicPlan

P = ParamSpec("P")
R = TypeVar("R")


class Turn(Enum):
    """When a command is executed, if others run."""

    IMMEDIATE = "at once, past every lock"
    CONCURRENT = "beside others"
    PROCEDURE = "for seconds, with progress, until it ends or is cancelled"


class Caller(Protocol):
    """Sends commands to an engine's process."""

    def call(self, name: str, *arguments: Any, **options: Any) -> Future[Any]:
        """Return the future result of a command, by its name."""


@dataclass(frozen=True, slots=True)
class Command(Generic[P, R]):
    """A command: on the class the record itself, on a client the method that sends it.

    Parameters
    ----------
    run : callable
        Executed in the engine's process.
    turn : Turn
        When it is executed, if others run.
    needs_rig : bool
        Refused while no rig is open.
    activates : bool
        Of a procedure: the calibration that it activated stays active; else that of before is restored.
    """

    run: Callable[Concatenate[Session, P], R]
    turn: Turn
    needs_rig: bool
    activates: bool

    @overload
    def __get__(self, client: None, owner: type) -> Self: ...
    @overload
    def __get__(self, client: Caller, owner: type) -> Callable[P, Future[R]]: ...
    def __get__(self, client: Caller | None, owner: type) -> Self | Callable[P, Future[R]]:
        return self if client is None else partial(client.call, self.run.__name__)


@dataclass(frozen=True, slots=True)
class command:
    """Make a command of the function that executes it; parameters as of `Command`."""

    turn: Turn = Turn.CONCURRENT
    needs_rig: bool = True
    activates: bool = False

    def __call__(self, run: Callable[Concatenate[Session, P], R]) -> Command[P, R]:
        """Return the command."""
        return Command(run, self.turn, self.needs_rig, self.activates)


class Commands:
    """All commands; a client inherits them as methods that return futures."""

    def call(self, name: str, *arguments: Any, **options: Any) -> Future[Any]:
        """Return the future result of a command, by its name."""
        raise NotImplementedError

    # the rig

    @command(needs_rig=False)
    def open(session: Session, rig: str) -> None:
        """Open a rig by its name; one that is open is closed first."""
        session.open(rig)

    @command()
    def configure(session: Session, settings: Settings) -> None:
        """Configure camera and timing."""
        session.engine.configure(settings)

    @command()
    def use(session: Session, calibration: Calibration | None) -> None:
        """Activate a calibration."""
        session.engine.use(calibration)

    @command()
    def start(session: Session) -> None:
        """Scan and stream."""
        session.engine.start()

    @command()
    def stop(session: Session) -> None:
        """Park the galvo and end the stream."""
        session.engine.stop()

    @command()
    def hold(session: Session, volts: float) -> None:
        """Hold the laser line still at a voltage."""
        session.engine.hold(volts)

    @command()
    def scan(session: Session) -> None:
        """Scan by the active calibration."""
        session.engine.scan()

    @command(Turn.IMMEDIATE)
    def park(session: Session) -> None:
        """Move the laser line off the bundle."""
        session.engine.park()

    # frames

    @command()
    def show(session: Session, view: LiveView) -> None:
        """Choose how live images are made for this view."""
        session.engine.show(view)

    @command()
    def record(session: Session, plan: RecordingPlan) -> None:
        """Record raw frames by a plan."""
        session.engine.record(plan)

    @command()
    def stop_recording(session: Session) -> None:
        """Finish the recording; returns when the file is complete."""
        session.engine.stop_recording()

    @command()
    def latencies(session: Session) -> Latencies:
        """Return how many frames of this run had which latency."""
        return session.engine.latencies()

    @command()
    def usage(session: Session) -> Usage:
        """Return what the engine's process has used."""
        return session.engine.usage()

    # the mosaic

    @command()
    def track(session: Session, plan: MosaicPlan | None) -> None:
        """Begin a mosaic by a plan, into which every frame is inserted; None ends insertion and keeps the mosaic."""
        session.mosaic.track(plan)

    @command()
    def undo_segment(session: Session) -> bool:
        """Remove the mosaic's last segment; return True if there was one."""
        return session.mosaic.undo()

    @command()
    def clear_mosaic(session: Session) -> None:
        """End tracking, and discard track and mosaic."""
        session.mosaic.clear()

    # calibrating

    @command(needs_rig=False, turn=Turn.IMMEDIATE)
    def cancel(session: Session) -> None:
        """Cancel the procedure that runs."""
        session.cancel()

    @command()
    def setup(session: Session) -> Setup:
        """Return with what settings frames are taken now."""
        from napari_elsplus.acquisition.calibrating import stepwise

        return stepwise.setup(session.engine)

    @command()
    def prepare(session: Session, target: Target | None) -> bool:
        """Put a target before the simulated rig's probe; return False for a real rig, whose user has to do it."""
        from napari_elsplus.acquisition.calibrating import stepwise

        return stepwise.prepare(session.rig, target)

    @command(Turn.PROCEDURE)
    def find_span(session: Session) -> tuple[float, float]:
        """Find the voltages between which the line lies on the bundle."""
        from napari_elsplus.acquisition.calibrating.whole import span_of_the_bundle

        return span_of_the_bundle(session.engine, session.watch("search for the bundle"))

    @command(Turn.PROCEDURE)
    def measure_offset(
        session: Session, volts: float, background: NDArray[np.float32] | None = None, pair: BundlePair | None = None
    ) -> SlitOffset:
        """Measure the slit offset, the line held at a voltage, from frames less a background."""
        from napari_elsplus.acquisition.calibrating import procedures

        return procedures.offset(session.engine, volts, background, pair)

    @command(Turn.PROCEDURE)
    def follow_offset(session: Session, volts: float, background: NDArray[np.float32] | None = None) -> None:
        """Measure the slit offset in every frame less a background, the line held at a voltage, until `cancel`."""
        from napari_elsplus.acquisition.calibrating import procedures

        procedures.follow_offset(
            session.engine, volts, background, tell=session.offsets.put, go_on=lambda: not session.cancelled
        )

    @command(needs_rig=False)
    def newest_offset(session: Session, number: int) -> tuple[int, SlitOffset | MeasurementError] | None:
        """Wait shortly for a result of `follow_offset` later than that number; return it with its number, or None."""
        return session.offsets.after(number)

    @command(Turn.PROCEDURE)
    def map_galvo(
        session: Session,
        volts: NDArray[np.floating],
        background: NDArray[np.float32] | None = None,
        pair: BundlePair | None = None,
    ) -> GalvoMap:
        """Sweep the line over voltages, and fit the galvo's map to frames less a background."""
        from napari_elsplus.acquisition.calibrating import procedures

        sweep, fit = session.watch("sweep"), session.watch("fit of the lines")
        return procedures.sweep(session.engine, volts, background, pair, sweep, fit)

    @command(Turn.PROCEDURE)
    def lit_pair(session: Session) -> LitPair:
        """Locate the pair of bundle images, and return the frame in which they were found."""
        from napari_elsplus.acquisition.calibrating import stepwise

        return stepwise.lit_pair(session.engine)

    @command(Turn.PROCEDURE)
    def lag_by(session: Session, calibration: Calibration) -> ScanLag:
        """Measure the scan's lag, scanning by a calibration."""
        from napari_elsplus.acquisition.calibrating import stepwise

        return stepwise.lag_by(session.engine, calibration, session.watch("scan lag"))

    @command(Turn.PROCEDURE)
    def background_by(session: Session, calibration: Calibration) -> Background:
        """Measure the background, scanning by a calibration."""
        from napari_elsplus.acquisition.calibrating import stepwise

        return stepwise.background_by(session.engine, calibration)

    @command(Turn.PROCEDURE)
    def flat_by(session: Session, calibration: Calibration) -> Flat:
        """Measure a flat field, scanning by a calibration."""
        from napari_elsplus.acquisition.calibrating import stepwise

        return stepwise.flat_by(session.engine, calibration)

    @command(Turn.PROCEDURE, activates=True)
    def calibrate_simulated(session: Session) -> tuple[Findings, ScanLag]:
        """Calibrate the simulated rig unattended, and activate the calibration."""
        from napari_elsplus.acquisition.calibrating.simulated import calibrate_simulated

        return calibrate_simulated(session.rig, session.engine, watch=session.watch)


COMMANDS: Final[Mapping[str, Command[..., Any]]] = {
    name: value for name, value in vars(Commands).items() if isinstance(value, Command)
}
