from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from benchmarks.harness import peers
from benchmarks.harness.methods import Absent
from napari_elsplus.errors import MeasurementError


@pytest.fixture
def foreign(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[peers.Peer]:
    """An environment that holds a stand-in for the peer: this interpreter, and a module of the peer's name."""
    scripts = tmp_path / "pyfibrebundle" / "bin"
    scripts.mkdir(parents=True)
    stand_in = tmp_path / "pybundle.py"
    stand_in.write_text(
        "print('loading')\n"
        "def g_filter(image, sigma):\n    return image * sigma\n"
        "def find_bundle(image):\n    raise ValueError('no bundle')\n"
    )
    python = scripts / "python"
    python.write_text(f'#!/bin/sh\nPYTHONPATH={tmp_path} exec {sys.executable} "$@"\n')
    python.chmod(0o755)
    monkeypatch.setenv("ELSPLUS_PEERS", str(tmp_path))
    peer = peers.Peer("PyFibreBundle")
    yield peer
    peer.close()


@pytest.mark.skipif(sys.platform == "win32", reason="the stand-in is a shell script")
def test_a_peer_answers_over_its_pipe_and_tells_its_time(foreign: peers.Peer) -> None:
    image = np.arange(6, dtype=np.float32).reshape(2, 3)
    answer, seconds = foreign("gaussian", image=image, sigma=2.0)
    np.testing.assert_array_equal(answer, 2 * image)
    assert 0 < seconds < 10


@pytest.mark.skipif(sys.platform == "win32", reason="the stand-in is a shell script")
def test_a_peers_own_error_is_its_answer_and_does_not_end_it(foreign: peers.Peer) -> None:
    with pytest.raises(MeasurementError, match="no bundle"):
        foreign("find_bundle", image=np.zeros((2, 2)))
    assert foreign("gaussian", image=np.ones(1), sigma=3.0).answer == 3


@pytest.mark.skipif(sys.platform == "win32", reason="the stand-in is a shell script")
def test_a_peer_that_dies_is_absent(foreign: peers.Peer) -> None:
    foreign._process.kill()
    foreign._process.wait()
    with pytest.raises(Absent, match="stopped"):
        foreign("gaussian", image=np.ones(1), sigma=3.0)


def test_a_peer_that_was_never_installed_is_absent(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ELSPLUS_PEERS", str(tmp_path))
    with pytest.raises(Absent, match=r"not installed: run `python3 run\.py bench peers`"):
        peers.Peer("PyFibreBundle")


def test_a_peer_that_pip_cannot_get_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ELSPLUS_PEERS", str(tmp_path))
    monkeypatch.setattr(peers.venv, "create", lambda *_, **__: None)
    failed = subprocess.CompletedProcess([], 1, "", "looking\nERROR: No matching distribution found\n")
    monkeypatch.setattr(peers.subprocess, "run", lambda *_, **__: failed)
    with pytest.raises(Absent, match="No matching distribution found"):
        peers.install("PyFibreBundle")
