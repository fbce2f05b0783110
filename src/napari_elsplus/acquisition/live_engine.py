"""A rig and its live engine in this process: opened together, guarded, parked and closed on every way out."""

from __future__ import annotations

import gc
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING

from napari_elsplus.acquisition.calibrating.simulated import open_live, use_simulated_calibration
from napari_elsplus.acquisition.engine.engine import Engine
from napari_elsplus.acquisition.engine.live_images import LiveView
from napari_elsplus.acquisition.engine.status import Settings
from napari_elsplus.hardware.priority import settle_memory
from napari_elsplus.hardware.rig import SIMULATED
from napari_elsplus.instrument.arguments import require_calibration
from napari_elsplus.processing.progress import without_display

if TYPE_CHECKING:
    from collections.abc import Iterator

    from napari_elsplus.hardware.rig import Rig
    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.processing.progress import Progress


@contextmanager
def live_engine(rig_name: str, settings: Settings) -> Iterator[tuple[Rig, Engine]]:
    """Open a rig and its engine.

    Parameters
    ----------
    rig_name : str
        One of :func:`napari_elsplus.hardware.rigs.rig_names`.
    settings : Settings
        How the camera runs.

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
        engine = held.enter_context(Engine(rig))
        engine.configure(settings)
        settle_memory()  # while it is collected, calls to the card seem to be stuck
        held.callback(gc.unfreeze)
        yield rig, engine


@contextmanager
def open_engine(
    rig: str = SIMULATED,
    *,
    calibration: Calibration | None = None,
    preset: str = "240hz",
    slit_rows: int = 3,
    frame_rate_hz: float | None = None,
    gain_db: float = 0.0,
    progress: Progress = without_display,
) -> Iterator[Engine]:
    """Open a rig and run its live engine in this process; leaving the context parks the galvo and closes the rig.

    Parameters
    ----------
    rig : str
        ``"simulated"``, or the name of a rig file; ``napari-elsplus doctor`` lists them.
    calibration : Calibration, optional
        Applied to images and scan. Without one the simulated rig is calibrated first (some seconds, once); a real rig
        then streams raw frames with the galvo parked.
    preset : str
        ``"240hz"`` or ``"120hz"``: camera region and objective.
    slit_rows : int
        Width of the rolling slit in rows.
    frame_rate_hz : float, optional
        Frames per second; the preset's highest by default.
    gain_db : float
        Gain of the camera.
    progress : Progress
        Wraps the numbers of each calibration step's frames, with the step's name: ``tqdm.tqdm``, for instance.

    Yields
    ------
    Engine
        Configured: ``start()``, ``record(...)``, ``status()``, ``stop()``.

    Raises
    ------
    DeviceError
        If the rig cannot be opened.
    InputError
        If there is no such rig, or its camera cannot do that.
    CalibrationError
        If the calibration does not fit the frames.
    """
    if calibration is not None:
        require_calibration(calibration)
    with live_engine(rig, Settings(preset, slit_rows, frame_rate_hz, gain_db)) as (opened, engine):
        if calibration is None and opened.bench is not None:
            engine.show(None)
            use_simulated_calibration(opened, engine, progress=progress)
            engine.show(LiveView())
        else:
            engine.use(calibration)
        yield engine
