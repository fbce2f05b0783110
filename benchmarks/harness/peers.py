"""Other projects' programs in environments of their own, answering over a pipe.

PyFibreBundle brings opencv-python, which writes into the same folder as the contrib-headless wheel that this project
uses: in one environment they break each other.
"""

from __future__ import annotations

import io
import os
import struct
import subprocess
import tempfile
import venv
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Final
from weakref import finalize

import numpy as np
import platformdirs

from benchmarks.harness.methods import Absent, TimedElsewhere
from napari_elsplus.errors import MeasurementError

if TYPE_CHECKING:
    from numpy.typing import NDArray

PACKAGES: Final = {"PyFibreBundle": ("PyFibreBundle", "numba")}
"""Requirements of each peer's environment."""
_WORKER: Final = Path(__file__).with_name("peer_worker.py")


def environment(peer: str) -> Path:
    """Folder of a peer's environment: in $ELSPLUS_PEERS, or else in the user's cache."""
    parent = os.environ.get("ELSPLUS_PEERS") or platformdirs.user_cache_path("napari-elsplus") / "peers"
    return Path(parent) / peer.lower()


def _python(peer: str) -> Path:
    folder = environment(peer)
    return folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")


def install(peer: str) -> str:
    """Make a peer's environment anew, with pip; return the version that was installed.

    Raises
    ------
    Absent
        If pip could not install it.
    """
    venv.create(environment(peer), clear=True, with_pip=True)
    pip = [str(_python(peer)), "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *PACKAGES[peer]]
    done = subprocess.run(pip, capture_output=True, text=True, check=False)
    if done.returncode:
        reason = (done.stderr.strip().splitlines() or ["pip failed"])[-1]
        raise Absent(f"{peer} could not be installed ({reason})", "is the package registry reachable?")
    ask = f"from importlib.metadata import version; print(version({peer!r}))"
    return subprocess.run([_python(peer), "-c", ask], capture_output=True, text=True, check=True).stdout.strip()


class Peer:
    """A peer's process; it tells what each call took in it.

    Parameters
    ----------
    name : str
        A key of `PACKAGES`.

    Attributes
    ----------
    close : callable
        Ends the process; it also ends with the object, and with the interpreter.

    Raises
    ------
    Absent
        If its environment was not made.
    """

    def __init__(self, name: str) -> None:
        if not _python(name).exists():
            raise Absent(f"{name} is not installed", "run `python3 run.py bench peers`")
        environ = {key: value for key, value in os.environ.items() if key not in {"PYTHONPATH", "PYTHONHOME"}}
        # a pipe that nobody reads would hold the peer up once it is full
        self._said = tempfile.TemporaryFile()  # noqa: SIM115 - closed with the process
        self._process = subprocess.Popen(
            [_python(name), str(_WORKER)], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            stderr=self._said, env=environ,
        )  # fmt: skip
        self.close = finalize(self, _end, self._process, self._said)
        self.name = name

    def __call__(self, task: str, **arrays: Any) -> TimedElsewhere:
        """Let it do a task; its answer, and the seconds that the task alone took.

        Raises
        ------
        MeasurementError
            If the peer raises an error of its own.
        Absent
            If its process ends.
        """
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        try:
            send(self._process.stdin, {"task": np.array(task), **{k: np.asarray(v) for k, v in arrays.items()}})
            answer = receive(self._process.stdout)
        except (BrokenPipeError, EOFError):
            self._process.kill()
            self._process.wait()
            self._said.seek(0)
            said = self._said.read().decode(errors="replace").strip().splitlines() or ["no word"]
            raise Absent(f"{self.name} stopped ({said[-1]})", "run `python3 run.py bench peers` again") from None
        if "error" in answer:
            raise MeasurementError(f"{self.name}: {answer['error']}", "that is its own error")
        return TimedElsewhere(answer["answer"], float(answer["seconds"]))


def _end(process: subprocess.Popen[bytes], said: IO[bytes]) -> None:
    process.kill()
    process.wait()
    said.close()
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            with suppress(BrokenPipeError):
                pipe.close()


@cache
def peer(name: str) -> Peer:
    """Return the peer's process, started once."""
    return Peer(name)


def send(pipe: Any, arrays: dict[str, NDArray[Any]]) -> None:
    """Write named arrays to a pipe."""
    packed = io.BytesIO()
    np.savez(packed, **arrays)  # type: ignore[arg-type]
    pipe.write(struct.pack("<Q", packed.getbuffer().nbytes))
    pipe.write(packed.getbuffer())
    pipe.flush()


def receive(pipe: Any) -> dict[str, NDArray[Any]]:
    """Read named arrays from a pipe.

    Raises
    ------
    EOFError
        If the other side is gone.
    """
    length = pipe.read(8)
    if len(length) < 8:
        raise EOFError
    (size,) = struct.unpack("<Q", length)
    with np.load(io.BytesIO(pipe.read(size)), allow_pickle=False) as packed:
        return dict(packed)
