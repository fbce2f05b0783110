"""The ramp learned through the engine, card and camera: of a galvo that is not what the rig's file states."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import numpy as np
import pytest

from napari_elsplus.acquisition.calibrating.live import LiveMeasurement, engine_setup
from napari_elsplus.acquisition.engine.engine import Engine
from napari_elsplus.acquisition.engine.status import Settings
from napari_elsplus.hardware.rigs import open_rig
from napari_elsplus.hardware.scan.waveform import GalvoLimits
from napari_elsplus.hardware.virtual.bench import OpticalBench, Simulation
from napari_elsplus.instrument.optics import preset
from napari_elsplus.processing.calibration.draft import Draft
from napari_elsplus.processing.calibration.steps import find_step
from napari_elsplus.simulation.model.imperfections import Imperfections
from napari_elsplus.simulation.specimen.scenes import uniform
from napari_elsplus.simulation.specimen.trajectories import Still

if TYPE_CHECKING:
    from napari_elsplus.hardware.virtual.camera.device import Shot
    from napari_elsplus.instrument.calibration import Calibration

SLIT_ROWS = 3
STATED = GalvoLimits(natural_hz=1000.0, damping=0.7)
SIMULATION = Simulation(
    scene=uniform(),
    trajectory=Still(),
    limits=STATED,
    imperfections=Imperfections.parse("galvo-resonance=800,galvo-damping=0.5,galvo-delay=60"),
)
SETTLED_FRAMES = 40


def live_row_errors(engine: Engine, bench: OpticalBench, shots: list[Shot], calibration: Calibration) -> np.ndarray:
    """Rows by which the line misses the middle of the slit while the rows that either view exposes are read."""
    bundle = calibration.bundle
    assert bundle is not None
    engine.use(calibration)
    engine.start()
    try:
        end_s = time.monotonic() + 60
        while engine.status().acquired < SETTLED_FRAMES:
            assert time.monotonic() < end_s
            time.sleep(0.05)
        off = bench.line_rows(shots[-1]) - np.arange(engine.setup.frame_shape[0])
    finally:
        engine.stop()
    centres, radius = (bundle.confocal_centre[0], bundle.residual_centre[0]), bundle.diameter_px / 2
    rows = np.arange(len(off))
    return np.asarray(off[(rows >= min(centres) - radius) & (rows <= max(centres) + radius)])


@pytest.mark.slow
def test_a_galvo_that_is_not_what_the_rig_states_scans_live_by_its_learned_ramp(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    shots: list[Shot] = []
    expose = OpticalBench.expose
    monkeypatch.setattr(OpticalBench, "expose", lambda bench, shot, out: (shots.append(shot), expose(bench, shot, out)))
    with open_rig("simulated", SIMULATION) as rig, Engine(rig) as engine:
        assert rig.bench is not None
        assert rig.limits == STATED
        engine.configure(Settings("240hz", SLIT_ROWS))
        step, draft = find_step("lag"), Draft(rig.bench.optics.calibration(preset("240hz")))
        draft = step.accept(draft, LiveMeasurement(engine).measure(step, draft), engine_setup(engine))
        learned = draft.calibration
        assert learned.galvo is not None
        galvo = learned.galvo.model_copy(update={"natural_hz": None, "damping": None})
        by_file = learned.model_copy(update={"galvo": galvo, "scan_correction": None})
        before, after = (live_row_errors(engine, rig.bench.optics, shots, by) for by in (by_file, learned))
        assert not engine.status().faults
    assert len(after) == 487
    assert np.count_nonzero(np.abs(before) > SLIT_ROWS / 4) > 200
    assert np.count_nonzero(np.abs(after) > SLIT_ROWS / 4) == 0
