"""Taps of the interpolation that aligns the residual view: cost against what is left of the core pattern."""

from __future__ import annotations

import sys
import tempfile
from functools import cache
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import cv2
import numpy as np

from benchmarks.harness.methods import Benchmark, Case, Judgement, Method, Role
from benchmarks.rigs.random_rigs import Rig
from napari_elsplus.processing.analysis.image_quality import alignment_error
from napari_elsplus.processing.images import resampling

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Image = NDArray[np.float32]

ELECTRONS: Final = 1e4
"""In a pixel that the camera shows as white: far more than in images, so that noise does not hide the pattern."""
MARGIN_PX: Final = 32
"""Added around frames, so that no kernel reaches beyond them: more than 16 taps."""


class Views(NamedTuple):
    """Both views of an evenly lit bundle, the confocal one on its own grid, and the map from that to the frame."""

    frame: Image
    confocal: Image
    grid_to_frame: NDArray[np.float64]
    gain: float
    diameter_px: float


def _views(seed: int) -> Views:
    rig = Rig.draw(seed).with_photons(ELECTRONS)
    frame = np.asarray(rig.bundle(1)[0], np.float32)
    side = int(rig.diameter_px) // 2 * 2 + 1
    first = [round(centre) - side // 2 for centre in rig.left]
    confocal = frame[first[0] : first[0] + side, first[1] : first[1] + side]
    back = cv2.invertAffineTransform(np.asarray(rig.residual_to_confocal, np.float64))
    back[:, 2] += back[:, :2] @ first + MARGIN_PX
    frame = cv2.copyMakeBorder(frame, *[MARGIN_PX] * 4, cv2.BORDER_CONSTANT)
    return Views(frame, confocal, back, rig.gain, rig.diameter_px)


def _cases(quick: bool) -> list[Case]:
    return [Case("evenly lit bundles, rigs drawn at random", [_views(seed) for seed in range(2 if quick else 12)])]


def judge(item: Views, answer: Image) -> Judgement:
    """Mean difference of the views over the mean of the confocal one, once the residual view is aligned."""
    return Judgement(alignment_error(item.confocal, answer / np.float32(item.gain), item.diameter_px))


@cache
def _with_lobes(lobes: int) -> Any:
    """Return the package's module of interpolation with another number of taps, which its kernel is compiled for."""
    source = Path(resampling.__file__).read_text("utf-8")
    changed = source.replace(f"LOBES: Final = {resampling.LOBES}\n", f"LOBES: Final = {lobes}\n")
    name = f"resampling_by_{2 * lobes}_taps"
    file = Path(tempfile.mkdtemp()) / f"{name}.py"
    file.write_text(changed, "utf-8")
    spec = spec_from_file_location(name, file)
    assert spec is not None
    assert spec.loader is not None
    module = sys.modules[name] = module_from_spec(spec)
    spec.loader.exec_module(module)
    assert lobes == module.LOBES
    return module


def _by_taps(count: int) -> Callable[[Case], Callable[[Views], Image]]:
    def prepare(case: Case) -> Callable[[Views], Image]:
        module = _with_lobes(count // 2)
        positions = ((item, module.affine_positions(item.grid_to_frame, len(item.confocal))) for item in case.items)
        resamplers = {id(item): module.Resampler(at) for item, at in positions}

        def resample(item: Views) -> Image:
            resampler = resamplers[id(item)]
            return np.asarray(resampler(resampler.window(item.frame), np.empty_like(item.confocal)))

        resample(case.items[0])  # compiles
        return resample

    return prepare


def _by_opencv(flag: int) -> Callable[[Case], Callable[[Views], Image]]:
    def resample(item: Views) -> Image:
        matrix = item.grid_to_frame[::-1][:, [1, 0, 2]]  # OpenCV's order: column, row
        side = len(item.confocal)
        return np.asarray(cv2.warpAffine(item.frame, matrix, (side, side), flags=flag | cv2.WARP_INVERSE_MAP))

    return lambda _: resample


BENCHMARK = Benchmark(
    name="taps",
    question="By how many taps the residual view is aligned",
    error_label="mean difference of the aligned views, share of the confocal one",
    cases=_cases,
    methods=(
        Method("16 taps", Role.OPTION, _by_taps(16)),
        Method("12 taps", Role.DEFAULT, _by_taps(12)),
        Method("8 taps", Role.OPTION, _by_taps(8)),
        Method("4 taps", Role.OPTION, _by_taps(4)),
        Method("Lanczos, 8 by 8, OpenCV", Role.PEER, _by_opencv(cv2.INTER_LANCZOS4)),
        Method("cubic, OpenCV", Role.PEER, _by_opencv(cv2.INTER_CUBIC)),
        Method("linear, OpenCV", Role.PEER, _by_opencv(cv2.INTER_LINEAR)),
    ),
    judge=judge,
    remarks=(
        "Taps of a windowed sinc in two passes, as calibrations resample views; sectioning has the same twelve fused "
        "into one pass over the frame. What is left with any number of taps is noise, and the core pattern above 0.4 "
        "cycles per pixel."
    ),
)
