"""A rig that is disturbed after its calibration is warned of while frames stream, once; one that is not, never."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace

import pytest

from napari_elsplus.acquisition.engine import watcher
from napari_elsplus.acquisition.engine.engine import Engine
from napari_elsplus.acquisition.engine.status import Settings
from napari_elsplus.hardware.rig import Rig
from napari_elsplus.hardware.rigs import open_rig
from napari_elsplus.hardware.virtual.bench import Simulation
from napari_elsplus.instrument.calibration import Calibration
from napari_elsplus.instrument.optics import preset
from napari_elsplus.processing.calibration.calibrate import measure
from napari_elsplus.processing.calibration.core_agreement import CoreAgreement
from napari_elsplus.simulation import calibration_scenes
from napari_elsplus.simulation.specimen.scenes import nuclei
from napari_elsplus.simulation.specimen.trajectories import Still

COMPARISONS = 6


@pytest.fixture
def compared(monkeypatch: pytest.MonkeyPatch) -> list[bool]:
    """Return a list that grows with each comparison, of which many are made in a second."""
    seen: list[bool] = []
    judge = CoreAgreement.disagreement

    def counted(self: CoreAgreement, frames: object) -> object:
        found = judge(self, frames)  # type: ignore[arg-type]
        seen.append(found is not None)
        return found

    monkeypatch.setattr(watcher, "COMPARISON_PERIOD_S", 0.02)
    monkeypatch.setattr(CoreAgreement, "disagreement", counted)
    return seen


@pytest.fixture
def rig() -> Iterator[Rig]:
    with open_rig("simulated", Simulation(scene=nuclei(5), trajectory=Still())) as rig:
        yield rig


def calibration(rig: Rig) -> Calibration:
    assert rig.bench is not None
    optics, chosen = rig.bench.optics, preset("240hz")
    found = measure(bundle=list(calibration_scenes.transmission(optics.instrument(chosen), seed=3))).calibration
    return optics.calibration(chosen).model_copy(update={"bundle": found.bundle, "flat": found.flat})


def until(engine: Engine, compared: list[bool], comparisons: int) -> str:
    end_s = time.monotonic() + 60
    while len(compared) < comparisons:
        assert time.monotonic() < end_s, "frames are not compared"
        time.sleep(0.02)
    time.sleep(0.05)
    return engine.status().disagreement


def until_judged(engine: Engine, compared: list[bool], disagrees: bool) -> None:
    end_s = time.monotonic() + 30
    while compared[-1] is not disagrees:
        assert time.monotonic() < end_s, "no comparison finds the change"
        until(engine, compared, len(compared) + 1)


def test_a_tilt_mirror_turned_while_frames_stream_is_warned_of_until_it_is_turned_back(
    rig: Rig, compared: list[bool]
) -> None:
    assert rig.bench is not None
    optics = rig.bench.optics
    with Engine(rig) as engine:
        engine.configure(Settings("240hz"))
        engine.use(calibration(rig))
        engine.start()
        assert until(engine, compared, COMPARISONS) == ""
        assert not any(compared)
        aligned = optics.simulation
        row_um = preset("240hz").optics.um_per_px
        optics.simulation = replace(aligned, offset_um=aligned.offset_um + row_um)
        until_judged(engine, compared, disagrees=True)
        warning = until(engine, compared, len(compared) + 2)
        assert "the residual view has moved by" in warning
        assert until(engine, compared, len(compared) + COMPARISONS) == warning
        optics.simulation = aligned
        until_judged(engine, compared, disagrees=False)
        assert until(engine, compared, len(compared) + 1) == ""
        assert engine.status().faults == ()


def test_a_bundle_that_lies_two_pixels_elsewhere_is_warned_of_and_trial_scans_are_not_compared(
    rig: Rig, compared: list[bool]
) -> None:
    with Engine(rig) as engine:
        engine.configure(Settings("240hz"))
        known = calibration(rig)
        bundle = known.measured_bundle
        (top, down), (left, across) = bundle.confocal_centre, bundle.residual_centre
        moved = {"confocal_centre": (top, down - 2), "residual_centre": (left, across - 2)}
        engine.use(known.model_copy(update={"bundle": bundle.model_copy(update=moved)}))
        engine.start()
        warning = until(engine, compared, 2)
        assert "the bundle has moved by" in warning
        assert "2.0 columns" in warning
        engine.scan(known)
        time.sleep(0.2)
        count = len(compared)
        time.sleep(0.3)
        assert len(compared) == count
