"""What the commands share that run the live engine: opened, guarded, closed on every way out, its progress shown."""

from __future__ import annotations

from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING

from napari_elsplus.acquisition.calibrating.simulated import open_live
from napari_elsplus.acquisition.engine.engine import Engine
from napari_elsplus.cli.options import progress
from napari_elsplus.hardware.guardian import Guardian

if TYPE_CHECKING:
    from collections.abc import Iterator

    from napari_elsplus.acquisition.calibrating.procedures import Watch
    from napari_elsplus.acquisition.engine.status import Settings
    from napari_elsplus.hardware.rig import Rig


@contextmanager
def live_engine(rig_name: str, settings: Settings) -> Iterator[tuple[Rig, Engine]]:
    """Open a rig and set its engine up; on a real rig, a guardian parks the mirror should this process die.

    Yields
    ------
    rig : Rig
        Open.
    engine : Engine
        In this process.

    Raises
    ------
    DeviceError
        If the rig cannot be opened.
    InputError
        If there is no such rig, or its camera cannot do that.
    """
    with ExitStack() as held:
        rig = open_live(rig_name)
        held.callback(rig.close)
        guarded = rig.park_order if rig.bench is None else None
        guardian = None if guarded is None else held.enter_context(Guardian(guarded))
        engine = held.enter_context(Engine(rig, guardian=guardian))
        engine.configure(settings)
        yield rig, engine


def watch_calibration(step: str) -> Watch:
    """Show how far a step of the calibration is."""
    return lambda numbers: progress(numbers, f"Calibrating: {step}")
