"""The simulated rig is calibrated once, and again when anything that its calibration depends on has changed."""

from __future__ import annotations

import os
from dataclasses import replace
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from napari_elsplus.acquisition.calibrating import live, simulated
from napari_elsplus.acquisition.engine.engine import Engine
from napari_elsplus.acquisition.engine.status import Settings
from napari_elsplus.hardware.rigs import open_rig
from napari_elsplus.hardware.virtual.bench import Simulation
from napari_elsplus.hardware.virtual.galvo import GalvoModel
from napari_elsplus.instrument.optics import preset
from napari_elsplus.processing.calibration.file_options import OWN_STEPS
from napari_elsplus.processing.calibration.step import REGISTERED
from napari_elsplus.processing.calibration.steps import BACKGROUND, calibration_steps

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from napari_elsplus.hardware.rig import Rig


@pytest.fixture
def measured(rig: Rig, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[str]:
    """Names of the presets calibrated, each in no time to the truth."""
    presets: list[str] = []
    assert rig.bench is not None
    optics = rig.bench.optics

    def calibrate(engine: Engine, prepare: Any, **_: Any) -> Any:
        name = engine.setup.settings.preset
        presets.append(name)
        background = np.ones(engine.setup.frame_shape, np.float32)
        engine.use(optics.calibration(preset(name)).model_copy(update={"background": background}))
        return SimpleNamespace(calibration=engine.calibration)

    monkeypatch.setattr(live, "calibrate_rig", calibrate)
    monkeypatch.setenv("ELSPLUS_CACHE", str(tmp_path))
    return presets


@pytest.fixture
def rig() -> Iterator[Rig]:
    with open_rig("simulated") as rig:
        yield rig


@pytest.fixture
def engine(rig: Rig) -> Iterator[Engine]:
    with Engine(rig) as engine:
        engine.configure(Settings("240hz"))
        yield engine


def start(rig: Rig, engine: Engine, name: str = "240hz") -> Any:
    engine.use(None)
    engine.configure(Settings(name))
    simulated.use_simulated_calibration(rig, engine)
    return engine.calibration


def test_the_second_start_recalls_what_the_first_measured(rig: Rig, engine: Engine, measured: list[str]) -> None:
    first, second = start(rig, engine), start(rig, engine)
    assert measured == ["240hz"]
    assert second.galvo == first.galvo
    assert (second.background == first.background).all()
    start(rig, engine, "120hz")
    assert measured == ["240hz", "120hz"]


def test_other_devices_and_other_software_measure_again(
    rig: Rig, engine: Engine, measured: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    files = {
        simulated.remembered_file(simulation, engine.setup)
        for simulation in (Simulation(), Simulation(galvo=replace(GalvoModel(), natural_hz=800.0)), Simulation(seed=1))
    }
    monkeypatch.setattr(simulated, "software_fingerprint", lambda: "edited")
    files.add(simulated.remembered_file(Simulation(), engine.setup))
    assert len(files) == 4


def test_a_step_that_another_package_adds_is_measured(
    rig: Rig, engine: Engine, measured: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert {step.key for step in calibration_steps()} == OWN_STEPS
    start(rig, engine)
    monkeypatch.setitem(REGISTERED, "read_noise", replace(BACKGROUND, key="read_noise"))
    start(rig, engine)
    start(rig, engine)
    assert measured == ["240hz", "240hz"]
    monkeypatch.delitem(REGISTERED, "read_noise")
    start(rig, engine)
    assert len(measured) == 2, "without it the first calibration is recalled"


def test_a_broken_file_and_a_folder_that_refuses_cost_only_time(
    rig: Rig, engine: Engine, measured: list[str], tmp_path: Path
) -> None:
    start(rig, engine)
    (file,) = tmp_path.rglob("*.json")
    file.write_text("{", encoding="utf-8")
    assert start(rig, engine).galvo is not None
    assert len(measured) == 2
    folder = file.parent
    for old in list(folder.iterdir()):
        old.unlink()
    folder.rmdir()
    folder.write_text("a file where the folder should be", encoding="utf-8")
    assert start(rig, engine).galvo is not None
    assert len(measured) == 3


def test_the_oldest_are_removed(tmp_path: Path, measured: list[str], rig: Rig, engine: Engine) -> None:
    calibration = start(rig, engine)
    for number in range(simulated.MAX_FILES + 3):
        simulated.remember_calibration(tmp_path / "many" / f"simulated-{number:02d}.json", calibration)
    assert len(list((tmp_path / "many").glob("*.json"))) == simulated.MAX_FILES
    assert len(list((tmp_path / "many").glob("*.npz"))) == simulated.MAX_FILES


def test_a_folder_that_may_not_be_written_costs_only_time(
    rig: Rig, engine: Engine, measured: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before: an error in place of the calibration, which had been measured."""
    monkeypatch.setattr(os, "access", lambda *_: False)
    assert start(rig, engine).galvo is not None
    assert len(measured) == 1
