from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numba
import numpy as np
import pytest

import napari_elsplus
from napari_elsplus.processing import compiled
from napari_elsplus.processing.compilation import reported_compilation

CALLER = """
from napari_elsplus.processing.compiled import kernel
from napari_elsplus.processing.inner import twice

@kernel
def outer(x):
    return twice(x) + 1.0
"""
INNER = """
from napari_elsplus.processing.compiled import kernel
from napari_elsplus.processing.instructions import ADDED

@kernel
def twice(x):
    return {factor} * x + ADDED
"""
INSTRUCTIONS = """
from llvmlite import ir

ADDED = {added}
"""


def answer(package: Path) -> str:
    """What the outer kernel returns in a process of its own, from the cache where there is one."""
    code = "from napari_elsplus.processing.outer import outer; print(outer(3.0), sum(outer.stats.cache_hits.values()))"
    environment = {**os.environ, "PYTHONPATH": str(package.parent)}
    environment.pop("NUMBA_CACHE_DIR", None)
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    return done.stdout.strip()


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A copy of what a kernel needs of the package, with two kernels of which one calls the other."""
    source, copy = Path(napari_elsplus.__file__).parent, tmp_path / "napari_elsplus"
    (copy / "processing").mkdir(parents=True)
    for name in ("__init__.py", "processing/__init__.py", "processing/compilation.py", "processing/compiled.py"):
        shutil.copy(source / name, copy / name)
    (copy / "processing" / "outer.py").write_text(CALLER)
    (copy / "processing" / "inner.py").write_text(INNER.format(factor="2.0"))
    (copy / "processing" / "instructions.py").write_text(INSTRUCTIONS.format(added="0.0"))
    return copy


def test_an_edited_kernel_is_compiled_again_into_those_that_call_it(package: Path) -> None:
    """numba alone compares the caller's own file, and would go on running the old callee."""
    assert answer(package) == "7.0 0"
    (package / "processing" / "inner.py").write_text(INNER.format(factor="5.0"))
    assert answer(package) == "16.0 0"
    (package / "processing" / "instructions.py").write_text(INSTRUCTIONS.format(added="0.5"))
    assert answer(package) == "16.5 0"
    assert answer(package) == "16.5 1"


def test_a_kernel_is_compiled_once_for_all_constants_that_other_kernels_pass() -> None:
    @compiled.kernel
    def scaled(x: float, factor: int) -> float:
        return factor * x

    @compiled.kernel
    def outer(x: float, factor: int) -> float:
        return scaled(x, 2) + scaled(x, factor=3) + scaled(x, factor)

    assert outer(1.0, 4) == 9.0
    assert len(scaled.signatures) == 1  # type: ignore[attr-defined]


def test_kernels_that_are_compiled_are_named_while_somebody_waits() -> None:
    @numba.njit
    def inner(x: float) -> float:
        return 2 * x

    @numba.njit
    def outer(x: float) -> float:
        return inner(x) + 1

    assert callable(compiled.kernel)  # importing it is enough
    named: list[str] = []
    with reported_compilation(named.append):
        assert outer(1.0) == outer(1.0) == 3.0
    assert named == ["outer", ""]
    assert outer(1) == 3
    assert named == ["outer", ""]


@compiled.lean_kernel
def total_weight(weights, scale):
    total = 0.0
    for k in range(len(weights[0])):
        total += scale * weights[0][k]
    return total


def test_a_kernel_resolved_once_returns_the_same() -> None:
    """At the first call, which compiles it, and at later ones."""
    resolved = compiled.resolved_once(total_weight)
    for weights in (np.arange(3.0), np.arange(7.0)):
        assert resolved((weights,), 2.0) == total_weight((weights,), 2.0) == 2 * weights.sum()
