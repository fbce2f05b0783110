"""Fixtures that several rooms' tests share."""

from __future__ import annotations

import functools
import gc
import os
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

from patience import be_patient

settings.register_profile("untimed", deadline=None)  # how fast a test is says more about the machine than about us
settings.load_profile("untimed")
signal.signal(signal.SIGINT, signal.default_int_handler)  # a job in the background ignores it, and its children too


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """Recordings with known truth and real images; tests that need them are skipped where they are absent."""
    default = Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = Path(os.environ.get("ELSPLUS_TEST_DATA", default))
    if not folder.is_dir():
        pytest.skip(f"no test data in {folder.name}: set ELSPLUS_TEST_DATA")
    return folder


@pytest.fixture(scope="session")
def open_recording(data_folder: Path) -> Path:
    """An ELS+ recording with known truth, made by a simulator that shares nothing with this project."""
    return data_folder / "open-recording"


@pytest.fixture(autouse=True)
def _settings_of_their_own(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    """No test reads or writes the settings of whoever runs it; frames of the simulated rig are made for all."""
    monkeypatch.setenv("ELSPLUS_CONFIG", str(tmp_path_factory.mktemp("settings")))
    cache = os.environ.get("ELSPLUS_TEST_CACHE", tmp_path_factory.getbasetemp() / "cache")
    monkeypatch.setenv("ELSPLUS_CACHE", str(cache))


@pytest.fixture(autouse=True)
def _a_busy_computer_is_no_stuck_device(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Only the tests of the hardware and of safety keep the limits of the drivers."""
    if request.path.relative_to(Path(__file__).parent).parts[0] not in ("hardware", "safety"):
        be_patient(monkeypatch.setattr)


@pytest.fixture(autouse=True)
def _priority_is_as_before_it() -> Iterator[None]:
    """What keeps the camera's pace in this process leaves its real-time priority to no other test."""
    interval_s, policy = sys.getswitchinterval(), _policy()
    yield
    sys.setswitchinterval(interval_s)
    if policy != _policy():
        os.sched_setscheduler(0, *policy)


def _policy() -> tuple[Any, ...]:
    """Policy and parameters of this thread's scheduling, on Linux."""
    return (os.sched_getscheduler(0), os.sched_getparam(0)) if sys.platform == "linux" else ()


@pytest.fixture
def _old_objects_are_left_alone() -> None:
    """napari and its fixtures often collect garbage; whatever was imported or left is not looked through each time."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session")
def _manifests_are_read_once() -> Iterator[None]:
    """Each new viewer would parse the manifests of all plugins again, a quarter of the time that it takes to open."""
    from npe2 import PluginManifest

    read = functools.cache(PluginManifest.from_file)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(PluginManifest, "from_file", staticmethod(lambda path: read(path).model_copy(deep=True)))
        yield


@pytest.fixture
def make_napari_viewer(
    _old_objects_are_left_alone: None, _manifests_are_read_once: None, make_napari_viewer: Callable[..., Any]
) -> Callable[..., Any]:
    """napari's own."""
    return make_napari_viewer
