"""The commands of the engine's process: one typed table, from which server and client derive.

Each command is written once, as the function that the engine's process executes. A client that inherits `Commands` has
a method of that name with the same parameters, which returns a future of the result.
"""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from enum import Enum
from functools import partial
from typing import TYPE_CHECKING, Any, Concatenate, Final, Generic, ParamSpec, Self, TypeVar, overload

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from concurrent.futures import Future

    from napari_elsplus.acquisition.engine.live_images import LiveView
    from napari_elsplus.acquisition.engine.status import Settings
    from napari_elsplus.acquisition.link.messages import Request
    from napari_elsplus.acquisition.link.session import Session
    from napari_elsplus.acquisition.streaming.recorder import RecordingPlan
    from napari_elsplus.errors import MeasurementError
    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.processing.calibration.draft import Draft, Setup
    from napari_elsplus.processing.calibration.slit_offset import SlitOffset
    from napari_elsplus.processing.calibration.step import CalibrationStep
    from napari_elsplus.workflows.mosaic_plan import MosaicPlan

P = ParamSpec("P")
R = TypeVar("R")


class Scheduling(Enum):
    """When a command is executed, if others run."""

    IMMEDIATE = "at once, past every lock"
    CONCURRENT = "beside others"
    EXCLUSIVE = "after exclusive ones that came before it; refused during a procedure"
    PROCEDURE = "exclusive for seconds, with progress, until it ends or is cancelled"


@dataclass(frozen=True, slots=True)
class Command(Generic[P, R]):
    """A command: on the class the record itself, on a client the method that sends it.

    Parameters
    ----------
    run : callable
        Executed in the engine's process.
    scheduling, needs_rig, while_recording, activates
        As of :func:`command`.
    """

    run: Callable[Concatenate[Session, P], R]
    scheduling: Scheduling
    needs_rig: bool
    while_recording: bool
    activates: bool

    @overload
    def __get__(self, client: None, owner: type) -> Self: ...
    @overload
    def __get__(self, client: Commands, owner: type) -> Callable[P, Future[R]]: ...
    def __get__(self, client: Commands | None, owner: type) -> Self | Callable[P, Future[R]]:
        return self if client is None else partial(client.call, self.run.__name__)


def command(
    scheduling: Scheduling = Scheduling.CONCURRENT,
    *,
    needs_rig: bool = True,
    while_recording: bool = True,
    activates: bool = False,
) -> Callable[[Callable[Concatenate[Session, P], R]], Command[P, R]]:
    """Return what makes a command of the function that executes it.

    Parameters
    ----------
    scheduling : Scheduling
        When it is executed, if others run.
    needs_rig : bool
        Refused while no rig is open.
    while_recording : bool
        Allowed while frames are recorded.
    activates : bool
        Of a procedure: the calibration that it activated stays active; else that of before is restored.
    """
    return lambda run: Command(run, scheduling, needs_rig, while_recording, activates)


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

    @command(Scheduling.EXCLUSIVE, while_recording=False)
    def configure(session: Session, settings: Settings) -> None:
        """Configure camera and timing."""
        session.engine.configure(settings)

    @command(Scheduling.EXCLUSIVE, while_recording=False)
    def use(session: Session, calibration: Calibration | None) -> None:
        """Activate a calibration."""
        session.engine.use(calibration)

    @command(Scheduling.EXCLUSIVE)
    def start(session: Session) -> None:
        """Scan and stream."""
        session.engine.start()

    @command(Scheduling.EXCLUSIVE)
    def stop(session: Session) -> None:
        """Park the galvo and end the stream."""
        session.engine.stop()

    @command(Scheduling.EXCLUSIVE)
    def hold(session: Session, volts: float) -> None:
        """Hold the laser line still at a voltage."""
        session.engine.hold(volts)

    @command(Scheduling.EXCLUSIVE)
    def scan(session: Session) -> None:
        """Scan by the active calibration."""
        session.engine.scan()

    @command(Scheduling.IMMEDIATE, needs_rig=False)
    def set_heartbeat_timeout(session: Session, timeout_s: float) -> None:
        """Park the galvo and end a recording after this time without a heartbeat of the client; see `Supervision`."""
        session.supervision.set_timeout(timeout_s)

    @command(Scheduling.IMMEDIATE)
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

    @command(Scheduling.IMMEDIATE, needs_rig=False)
    def cancel(session: Session) -> None:
        """Cancel the procedure that runs."""
        session.cancel()

    @command()
    def setup(session: Session) -> Setup:
        """Return the settings with which frames are taken now."""
        from napari_elsplus.acquisition.calibrating.live import engine_setup

        return engine_setup(session.engine)

    @command(Scheduling.PROCEDURE, while_recording=False)
    def measure_step(session: Session, step: CalibrationStep[Any], draft: Draft, voltages: int | None = None) -> Any:
        """Measure a calibration step with what a draft contains, a sweep with so many voltages (400 by default)."""
        from napari_elsplus.acquisition.calibrating.live import SWEEP_VOLTAGES, LiveMeasurement
        from napari_elsplus.acquisition.calibrating.simulated import target_placed

        with target_placed(session.rig, step.target):
            return LiveMeasurement(session.engine, voltages or SWEEP_VOLTAGES, session.watch).measure(step, draft)

    @command(Scheduling.PROCEDURE, while_recording=False)
    def follow_offset(session: Session, draft: Draft) -> None:
        """Measure the slit offset in every frame, the line held where a draft places it, until `cancel`."""
        from napari_elsplus.acquisition.calibrating.live import follow_offset
        from napari_elsplus.acquisition.calibrating.simulated import target_placed
        from napari_elsplus.processing.calibration.steps import OFFSET

        with target_placed(session.rig, OFFSET.target):
            follow_offset(
                session.engine, draft, session.offsets.put, lambda: not session.cancelled, session.report_progress
            )

    @command(needs_rig=False)
    def newest_offset(session: Session, number: int) -> tuple[int, SlitOffset | MeasurementError] | None:
        """Wait shortly for a result of `follow_offset` later than that number; return it with its number, or None."""
        return session.offsets.after(number)

    @command(Scheduling.PROCEDURE, while_recording=False, activates=True)
    def calibrate_simulated(session: Session) -> Draft:
        """Calibrate the simulated rig unattended, and activate the calibration."""
        from napari_elsplus.acquisition.calibrating.simulated import calibrate_simulated

        return calibrate_simulated(session.rig, session.engine, progress=session.watch)

    @command(Scheduling.PROCEDURE, while_recording=False, activates=True)
    def use_simulated_calibration(session: Session) -> None:
        """Activate the remembered calibration of the simulated rig; if there is none, calibrate it unattended."""
        from napari_elsplus.acquisition.calibrating.simulated import use_simulated_calibration

        use_simulated_calibration(session.rig, session.engine, progress=session.watch)


COMMANDS: Final[Mapping[str, Command[..., Any]]] = {
    name: value for name, value in vars(Commands).items() if isinstance(value, Command)
}


def execute(session: Session, request: Request, given_s: float) -> Any:
    """Execute a command in the engine's process, and return its result.

    Parameters
    ----------
    session : Session
        The open rig.
    request : Request
        Name and arguments of the command.
    given_s : float
        When it came, by ``time.perf_counter``: it does not move a galvo that was parked since then.

    Raises
    ------
    DeviceError
        If it needs a rig and none is open.
    InputError
        If it has to wait for a recording or another operation.
    """
    command, title = COMMANDS[request.name], request.name.replace("_", " ")
    with ExitStack() as held:
        if command.needs_rig:
            engine = session.engine
            if not command.while_recording:
                engine.refuse_while_recording()
            if command.scheduling is Scheduling.EXCLUSIVE:
                held.enter_context(engine.operations.alone(title, given_s=given_s))
            elif command.scheduling is Scheduling.PROCEDURE:
                held.enter_context(session.procedure(title, given_s, activates=command.activates))
        return command.run(session, *request.arguments, **request.options)
