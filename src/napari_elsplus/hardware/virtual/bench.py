"""The optical bench: strobe, card, galvo and sensor on one clock, so that a wrong ramp gives a wrong image."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from napari_elsplus.hardware.scan.waveform import GalvoLimits
from napari_elsplus.hardware.virtual.galvo import STEADY_AFTER, GalvoModel, imperfect_galvo
from napari_elsplus.hardware.virtual.scene_frames import SceneFrames
from napari_elsplus.hardware.virtual.timeline import BenchClock, Program, StrobeTrain
from napari_elsplus.instrument.optics import PRESETS, Preset
from napari_elsplus.simulation.model.imperfections import IDEAL, Imperfections
from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.simulation.specimen.scenes import Scene, fibres
from napari_elsplus.simulation.specimen.trajectories import Circle, Still, Trajectory
from napari_elsplus.simulation.truth import true_calibration

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from napari_elsplus.hardware.virtual.camera.device import Shot
    from napari_elsplus.hardware.virtual.card.card import VirtualCard
    from napari_elsplus.hardware.virtual.card.process import RemoteCard
    from napari_elsplus.instrument.calibration import Calibration


@dataclass(frozen=True)
class Simulation:
    """Scene, motion and devices of the simulated rig.

    Parameters
    ----------
    scene : Scene
        Specimen in front of the probe.
    trajectory : Trajectory
        Motion of the probe, from the start of each stream on; a closed one is rendered once and replayed.
    offset_um : float
        Slit offset at the bundle, signed.
    galvo : GalvoModel
        The galvo, but for its imperfections.
    limits : GalvoLimits, optional
        Limits and galvo as a rig file states them; `galvo` is stated by default.
    imperfections : Imperfections
        Departures from the ideal instrument, among them those of the galvo from the rig file.
    seed : int
        Seed of the camera's noise.
    real_time : bool
        Frames come at the camera's rate; otherwise as fast as they are read, and none is ever lost.
    own_process : bool
        The card lives in a process of its own, so that it outlives this one; needs `real_time`.
    instrument : dict
        Further fields of `Instrument`.
    """

    scene: Scene = field(default_factory=fibres)
    trajectory: Trajectory = field(default_factory=Circle)
    offset_um: float = -29.0
    galvo: GalvoModel = field(default_factory=GalvoModel)
    seed: int = 0
    real_time: bool = True
    own_process: bool = False
    instrument: dict[str, Any] = field(default_factory=dict)
    limits: GalvoLimits | None = None
    imperfections: Imperfections = IDEAL

    @property
    def stated_limits(self) -> GalvoLimits:
        """Limits and galvo as the rig states them."""
        return self.limits or GalvoLimits(natural_hz=self.galvo.natural_hz, damping=self.galvo.damping)

    @property
    def moved_galvo(self) -> GalvoModel:
        """The galvo as it moves, with its imperfections."""
        return imperfect_galvo(self.galvo, self.imperfections)


class OpticalBench:
    """Renders camera frames with the laser line where card and galvo place it.

    Parameters
    ----------
    simulation : Simulation
        Scene, optics, galvo.
    card : VirtualCard or RemoteCard
        The virtual card, in this process or in one of its own.
    clock : BenchClock
        Clock of both.
    """

    def __init__(self, simulation: Simulation, card: VirtualCard | RemoteCard, clock: BenchClock) -> None:
        self.simulation, self.card, self.clock = simulation, card, clock
        self._lock = threading.Lock()
        self._frames: SceneFrames | None = None
        self._steady: tuple[Program, Shot, NDArray[np.float64]] | None = None
        """Program and camera settings, and the line's rows of every frame once the galvo's motion is periodic."""

    def show(self, scene: Scene, trajectory: Trajectory | None = None) -> None:
        """Replace the scene, and the trajectory (at rest by default), from the next frame on."""
        with self._lock:
            self.simulation = replace(self.simulation, scene=scene, trajectory=trajectory or Still())

    def instrument(self, preset: Preset, slit_rows: float = 3.0, gain_db: float = 0.0) -> Instrument:
        """Return the optics of the bench in one of the camera's settings.

        Parameters
        ----------
        preset : Preset
            Region and frame rate.
        slit_rows : float
            Slit width in rows.
        gain_db : float
            Gain in dB.
        """
        known = Instrument.of(preset.name if preset.name in PRESETS else "120hz", offset_um=self.simulation.offset_um)
        simulation = self.simulation
        fields = {"imperfections": simulation.imperfections, **simulation.instrument}
        changed = replace(known, preset=preset, slit_rows=slit_rows, **fields)
        return changed.with_gain_db(gain_db) if gain_db else changed

    def calibration(self, preset: Preset, slit_rows: float = 3.0) -> Calibration:
        """Return the true calibration for a preset and a slit of `slit_rows`, the galvo's lag included."""
        perfect = true_calibration(self.instrument(preset, slit_rows))
        return perfect.with_galvo(lag_s=self.simulation.moved_galvo.lag_s)

    def moved_s(self) -> float:
        """Return when the card was given its last voltage or ramp."""
        return self.card.programs()[-1].since_s

    def line_rows(self, shot: Shot) -> NDArray[np.float64]:
        """Return the row of the confocal view on which the line is in the middle of each row's exposure of a shot."""
        programs = self.card.programs()
        newest, settings = programs[-1], replace(shot, frame=0, strobe_s=0.0, skipped=0)
        if self._steady is None or self._steady[0] is not newest or self._steady[1] != settings:
            rows = self._rows_by(programs, shot)
            settled_s = newest.begins_s + STEADY_AFTER * shot.frame_period_s
            if shot.strobe_s < settled_s or not newest.recurs(shot.frame_period_s):
                return rows
            self._steady = newest, settings, rows
        return self._steady[2]

    def _rows_by(self, programs: Sequence[Program], shot: Shot) -> NDArray[np.float64]:
        rows = np.arange(shot.region[2], dtype=np.float64)
        exposed = np.asarray(shot.row_zero_s + rows * shot.line_period_s - shot.exposure_s / 2)
        volts = self.simulation.moved_galvo.position(programs, exposed, shot.strobe_s)
        return self._instrument_of(shot).line_row(volts)

    # The camera's side.

    def strobe(self, train: StrobeTrain | None) -> None:
        """Pass the camera's strobe train on to the card."""
        self.card.strobe(train)

    def prepare(self, shot: Shot) -> None:
        """Build, compile and, for a closed path, render ahead, so that the first frame of a shot comes in time."""
        with self._lock:
            self._source(shot).render_ahead(self._steady_rows(shot))

    def expose(self, shot: Shot, out: NDArray[np.uint8]) -> None:
        """Fill the frame `out` of a shot."""
        with self._lock:
            self._source(shot).fill(shot.frame, out, self.line_rows(shot), lit_frames=shot.frame - shot.skipped)

    def _steady_rows(self, shot: Shot) -> NDArray[np.float64]:
        """Return the line's row during each row's exposure once the stream about to start is periodic."""
        train = StrobeTrain(shot.strobe_s, shot.frame_period_s)
        program = replace(self.card.programs()[-1], since_s=shot.strobe_s - shot.frame_period_s, strobe=train)
        later = replace(shot, frame=STEADY_AFTER, strobe_s=shot.strobe_s + STEADY_AFTER * shot.frame_period_s)
        return self._rows_by([program], later)

    def _instrument_of(self, shot: Shot) -> Instrument:
        return self.instrument(preset_of(shot), shot.exposure_s / shot.line_period_s, shot.gain_db)

    def _source(self, shot: Shot) -> SceneFrames:
        wanted, simulation = self._instrument_of(shot), self.simulation
        frames = self._frames
        if frames is None or not frames.shows(wanted, simulation.scene, simulation.trajectory):
            ahead = simulation.real_time
            frames = SceneFrames(wanted, simulation.scene, simulation.trajectory, simulation.seed, ahead=ahead)
            self._frames = frames
        return frames


def preset_of(shot: Shot) -> Preset:
    """Return the preset that has a shot's region, at the shot's frame rate; of the 10x objective if none has."""
    row, col, rows, cols = shot.region
    known = next(
        (p for p in PRESETS.values() if p.frame_shape == (rows, cols) and p.sensor_origin == (row, col)),
        replace(PRESETS["120hz"], name="custom", frame_shape=(rows, cols), sensor_origin=(row, col)),
    )
    optics = replace(
        known.optics,
        line_period_s=shot.line_period_s,
        line_periods_per_frame=shot.frame_period_s / shot.line_period_s,
    )
    return replace(known, optics=optics)
