"""Failure map of registration: large shifts, dim light, a fixed pattern, poor texture, distortion."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import cv2
import numpy as np

from benchmarks.choices.registration import METHODS, judge, pairs_along
from benchmarks.harness.methods import Benchmark, Case, Chart, named, stressed
from benchmarks.rigs.simulated import SimulatedRig, dim, jumps, measured, simulated_rig
from napari_elsplus.processing.tracking.front_end.grid import Grid
from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.simulation.specimen.scenes import Plane, Scene, fibres
from napari_elsplus.simulation.specimen.textures import Fibres

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Image = NDArray[np.float32]

SHIFT_PX = 20.0
_SEED = 3
_SHOWN = (
    "link, predicted", "link, searched", "template", "OpenCV phaseCorrelate", "OpenCV ECC, predicted", "PyFibreBundle",
)  # fmt: skip


def _pairs(rig: SimulatedRig, looked_at: Scene, px: float, count: int) -> Case:
    grid = Grid.of(rig.calibration)
    path = jumps(count, px, rig, grid.binning, _SEED)
    return Case("", pairs_along(rig, looked_at, path, _SEED, np.random.default_rng(_SEED)), context=grid)


def _later(case: Case, change: Callable[[Image, np.random.Generator], Image]) -> Case:
    """Change the later image of every pair."""
    random = np.random.default_rng(5)
    changed = [pair._replace(later=np.ascontiguousarray(change(pair.later, random), np.float32)) for pair in case.items]
    return replace(case, items=changed)


def _both(case: Case, change: Callable[[Image], Image]) -> Case:
    changed = [
        pair._replace(earlier=change(pair.earlier).astype(np.float32), later=change(pair.later).astype(np.float32))
        for pair in case.items
    ]
    return replace(case, items=changed)


def _turned(degrees: float, case: Case) -> Case:
    row, col = case.context.centre
    turn = cv2.getRotationMatrix2D((col, row), degrees, 1.0)
    return _later(case, lambda image, _: np.asarray(cv2.warpAffine(image, turn, image.shape, flags=cv2.INTER_CUBIC)))


def _deformed(px: float, case: Case) -> Case:
    """Bend the later image by a smooth field of that root-mean-square displacement and none on average."""

    def bend(image: Image, random: np.random.Generator) -> Image:
        field = [cv2.GaussianBlur(random.normal(size=image.shape).astype(np.float32), (0, 0), 30) for _ in range(2)]
        field = [f - f.mean() for f in field]
        rows, cols = np.indices(image.shape, np.float32)
        down, across = (f * np.float32(px / np.sqrt(2) / f.std()) for f in field)
        return np.asarray(cv2.remap(image, cols + across, rows + down, cv2.INTER_LINEAR))

    return _later(case, bend)


def _patterned(share: float, case: Case) -> Case:
    """Leave a fixed pattern on both images, as a flat field of another day does."""
    side = case.context.side
    pattern = cv2.GaussianBlur(np.random.default_rng(7).normal(size=(side, side)).astype(np.float32), (0, 0), 1.0)
    factor = 1 + np.float32(share) * pattern / pattern.std()
    return _both(case, lambda image: image * factor)


def _dimmed(share: float, case: Case) -> Case:
    """Let the light of the later image fall to that share towards one side."""
    return _later(case, lambda image, _: image * np.linspace(1, share, len(image), dtype=np.float32))


def _saturated(factor: float, case: Case) -> Case:
    """Clip both images at their white divided by that factor."""
    return _both(case, lambda image: np.minimum(image, np.quantile(image, 0.999) / np.float32(factor)))


def _sparse(per_mm2: float) -> Scene:
    return Scene((Plane(Fibres(per_mm2=per_mm2, seed=4)),))


def _cases(quick: bool) -> list[Case]:
    count = 2 if quick else 10
    rig, looked_at = simulated_rig(), fibres(4)
    base = _pairs(rig, looked_at, SHIFT_PX, count)
    stresses: dict[str, tuple[tuple[float, ...], Callable[[float], Case]]] = {
        "rotation / degrees": ((1, 2, 4, 8), lambda x: _turned(x, base)),
        "deformation, rms / px": ((1, 2, 4, 8), lambda x: _deformed(x, base)),
        "fixed pattern, share of the light": ((0.1, 0.2, 0.4, 0.8), lambda x: _patterned(x, base)),
        "light falls across the image to": ((0.5, 0.2, 0.05), lambda x: _dimmed(x, base)),
        "over-exposure, times": ((1, 4, 16), lambda x: _saturated(x, base)),
    }
    if not quick:
        stresses = {
            "shift / px of 234": ((20, 60, 100, 140), lambda x: _pairs(rig, looked_at, x, count)),
            "electrons of white": (
                (3200, 16, 4, 1), lambda x: _pairs(dim(x), looked_at, SHIFT_PX, count)
            ),
            "fibres in a square mm": ((30, 8, 3, 1), lambda x: _pairs(rig, _sparse(x), SHIFT_PX, count)),
            "slit offset / um": (
                (-3, -6, -12, -65), lambda x: _pairs(simulated_rig(offset_um=x), looked_at, SHIFT_PX, count)
            ),
            "slit / rows": (
                (1, 6, 24), lambda x: _pairs(measured(Instrument.of("240hz", slit_rows=x)), looked_at, SHIFT_PX, count)
            ),
        } | stresses  # fmt: skip
    return stressed(stresses, worst=2 if quick else None)


BENCHMARK = Benchmark(
    name="stability",
    question="Where registration fails, in % of the pairs",
    error_label="error / px",
    cases=_cases,
    methods=named(METHODS, _SHOWN),
    judge=judge,
    chart=Chart.FAILURES,
    seconds=0.0,
    remarks="A failure is an error above 3 px. Predicted methods start about 3 px from the truth.",
)
