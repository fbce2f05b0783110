"""A season of two recordings and a file that is none; a client that executes tasks in the test's own process."""

from __future__ import annotations

from contextlib import contextmanager
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import tifffile

from napari_elsplus.io import write_calibration
from napari_elsplus.workflows.batch import run
from napari_elsplus.workflows.simulated import simulate_recording

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path


@pytest.fixture(scope="session")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three recordings of four frames, the second of which is no TIFF."""
    folder = tmp_path_factory.mktemp("season")
    for name, seed in (("a", 1), ("c", 2)):
        made = simulate_recording(frames=4, seed=seed)
        tifffile.imwrite(folder / f"{name}.tif", np.stack(list(made)), photometric="minisblack")
        write_calibration(folder / f"{name}.calibration.json", made.calibration)
    (folder / "b.tif").write_bytes(b"not a TIFF at all")
    return folder


class Task:
    """A future of :class:`InlineClient`."""

    def __init__(self, function: Callable[..., Any], arguments: tuple[Any, ...], priority: int) -> None:
        self.function, self.arguments, self.priority = function, arguments, priority

    @cached_property
    def outcome(self) -> tuple[Any, Exception | None]:
        """What the task returns or raises, after the tasks of which it takes the results."""
        try:
            resolved = ([one.result() for one in part] if isinstance(part, list) else part for part in self.arguments)
            return self.function(*resolved), None
        except Exception as error:  # noqa: BLE001 - raised by `result`
            return None, error

    def result(self) -> Any:
        found, error = self.outcome
        if error is not None:
            raise error
        return found

    def exception(self) -> Exception | None:
        return self.outcome[1]


class InlineClient:
    """Executes tasks in this process, one after the other, as they are waited for."""

    dashboard_link = "http://127.0.0.1:1/status"

    def submit(self, function: Callable[..., Any], *arguments: Any, pure: bool, priority: int) -> Task:
        assert not pure
        return Task(function, arguments, priority)

    def nthreads(self) -> dict[str, int]:
        return {"worker": 1}


class Completed:
    """Tasks by their priority; others may be added while they are executed."""

    def __init__(self, tasks: list[Task]) -> None:
        self.tasks = list(tasks)

    def add(self, task: Task) -> None:
        self.tasks.append(task)

    def __iter__(self) -> Iterator[Task]:
        while self.tasks:
            first = max(self.tasks, key=lambda task: task.priority)
            self.tasks.remove(first)
            yield first


@pytest.fixture
def inline(monkeypatch: pytest.MonkeyPatch) -> None:
    @contextmanager
    def client(*_: object) -> Iterator[InlineClient]:
        yield InlineClient()

    monkeypatch.setattr(run, "batch_client", client)
    monkeypatch.setattr("distributed.as_completed", Completed)
