"""The live engine on the simulated rig, in this process or in one of its own, driven alike."""

from __future__ import annotations

import os
import time
from typing import TYPE_CHECKING, Any, Self

from napari_elsplus.acquisition.calibrating.simulated import open_live
from napari_elsplus.acquisition.engine.engine import Engine
from napari_elsplus.acquisition.engine.status import Settings
from napari_elsplus.acquisition.link.client import EngineClient
from napari_elsplus.acquisition.link.server import STATUS_PERIOD_S
from napari_elsplus.acquisition.mosaic.tracking import LiveTrack
from napari_elsplus.acquisition.streaming.recorder import RecordingPlan
from napari_elsplus.hardware.priority import keep_pace, settle_memory
from napari_elsplus.hardware.rig import SIMULATED
from napari_elsplus.hardware.virtual.bench import Simulation
from napari_elsplus.simulation.calibration_scenes import background
from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.simulation.truth import true_calibration

if TYPE_CHECKING:
    from pathlib import Path

    from napari_elsplus.acquisition.engine.live_images import LiveView
    from napari_elsplus.acquisition.engine.status import Status
    from napari_elsplus.acquisition.streaming.ring import Ring
    from napari_elsplus.instrument.calibration import Calibration


class Here:
    """The engine in this process.

    Parameters
    ----------
    name : str
        Preset.
    record : pathlib.Path, optional
        File of a recording.
    track : bool
        Whether every frame is tracked and laid into a mosaic, too.
    view : LiveView, optional
        The live images; all by default.
    """

    def __init__(
        self, name: str, *, record: Path | None = None, track: bool = False, view: LiveView | None = None
    ) -> None:
        keep_pace()
        self._record = record
        self._engine = engine = Engine(open_live(SIMULATED))
        engine.configure(Settings(name))
        calibration = perfect_calibration(name)
        engine.use(calibration)
        if view is not None:
            engine.show(view)
        self._track = LiveTrack(calibration, engine.setup.frame_shape) if track else None
        engine.track(self._track)
        settle_memory()

    def begin(self) -> None:
        """Stream, and record if asked."""
        self._engine.start()
        if self._record is not None:
            self._engine.record(RecordingPlan(self._record, force=True))

    def end(self) -> None:
        """Stop."""
        self._engine.stop()
        self._engine.finish_recording()

    def ring(self) -> Ring | None:
        """Return where images are shown."""
        return self._engine.display

    @property
    def pid(self) -> int:
        """Number of this process."""
        return os.getpid()

    def outcome(self) -> Status:
        """Return what was counted."""
        return self._engine.status()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *reason: object) -> Any:
        self._engine.close()
        if self._track is not None:
            self._track.close()


class Apart:
    """The engine in a process of its own, as napari uses it.

    Parameters
    ----------
    name : str
        Preset.
    """

    def __init__(self, name: str) -> None:
        self._client = client = EngineClient()
        client.open(SIMULATED).result()
        client.configure(Settings(name)).result()
        client.use(perfect_calibration(name)).result()

    def begin(self) -> None:
        """Stream."""
        self._client.start().result()

    def end(self) -> None:
        """Stop."""
        self._client.stop().result()

    def ring(self) -> Ring | None:
        """Return where images are shown."""
        return self._client.display()

    @property
    def pid(self) -> int:
        """Number of the engine's process."""
        return self._client.pid

    def outcome(self) -> Status:
        """Return what was counted."""
        time.sleep(2 * STATUS_PERIOD_S)  # it says by itself how it went
        return self._client.status

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *reason: object) -> Any:
        self._client.close()


def perfect_calibration(name: str) -> Calibration:
    """Return what a perfect calibration of the simulated rig would say."""
    simulation = Simulation()
    instrument = Instrument.of(name, offset_um=simulation.offset_um)
    perfect = true_calibration(instrument, background(instrument))
    assert perfect.galvo is not None
    galvo = perfect.galvo.model_copy(update={"lag_s": simulation.galvo.lag_s})
    return perfect.model_copy(update={"galvo": galvo})
