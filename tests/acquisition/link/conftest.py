"""Engines' processes on a rig of a few lines, and the log of their galvo."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from napari_elsplus.acquisition.engine.status import Settings
from napari_elsplus.acquisition.link.client import EngineClient

PROCESS = Path(__file__).parents[1] / "engine_process.py"
SLOW = Settings("240hz", frame_rate_hz=100.0)


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """File in which the engine's process notes what the galvo does."""
    path = tmp_path / "mirror.log"
    path.touch()
    return path


@pytest.fixture
def command(log: Path) -> tuple[str, ...]:
    """What starts the engine's process."""
    return (sys.executable, str(PROCESS), str(log))


@pytest.fixture
def own_client(command: tuple[str, ...]) -> Iterator[EngineClient]:
    """The client of a process that ends with the test."""
    with EngineClient(command) as client:
        client.open("small").result(60)
        client.configure(SLOW).result(60)
        yield client


@pytest.fixture(scope="module")
def process(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[EngineClient, Path]]:
    """The client of a process for all tests of a module that leave it alive, and its log."""
    log = tmp_path_factory.mktemp("process") / "mirror.log"
    with EngineClient((sys.executable, str(PROCESS), str(log))) as client:
        yield client, log


@pytest.fixture
def client(process: tuple[EngineClient, Path]) -> EngineClient:
    """The client of a process that opens its rig anew for the test."""
    client, _ = process
    client.open("small").result(60)
    client.configure(SLOW).result(60)
    return client


@pytest.fixture
def shared_log(process: tuple[EngineClient, Path], client: EngineClient) -> Path:
    """The log of `client`, from the test's begin."""
    _, log = process
    log.write_text("")
    return log
