"""Sectioning: ELS+ in signed numbers against saturating ones, ELSA, and LS alone.

What perfect sectioning would show is known: the same view of the focal plane alone, without noise.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import cv2
import numpy as np

from benchmarks.harness.agreement import unexplained
from benchmarks.harness.methods import Benchmark, Case, Judgement, Method, Role
from benchmarks.rigs.simulated import SimulatedRig, simulated_rig
from napari_elsplus.processing.analysis.image_quality import USED_DIAMETER
from napari_elsplus.processing.images.sectioning import Mode, Sectioner, disc
from napari_elsplus.simulation.accuracy import SMOOTHING_PX
from napari_elsplus.simulation.specimen.scenes import scene
from napari_elsplus.simulation.specimen.trajectories import Straight

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Image = NDArray[np.float32]
    Frame = NDArray[np.uint8]


class Moment(NamedTuple):
    """A raw frame, the one after it, and the focal plane as the confocal view shows it without noise."""

    raw: Frame
    following: Frame
    in_focus: Image


def moments(rig: SimulatedRig, name: str, speed_um_s: float, count: int) -> list[Moment]:
    """Frames of a moving probe."""
    path, looked_at = Straight(speed_um_s), scene(name)
    frames = rig.recording(looked_at, path, count + 1)
    expected = rig.recording(looked_at.in_focus(), path, count, noise=False)
    ls = Sectioner(rig.calibration, rig.instrument.frame_shape).ls
    return [Moment(frames[k], frames[k + 1], ls(expected[k])) for k in range(count)]


def _cases(quick: bool) -> list[Case]:
    count = 1 if quick else 6
    rig = simulated_rig()
    made = [Case("fibres, slow probe", moments(rig, "fibres", 100, count), context=rig)]
    if not quick:
        slow = simulated_rig(rate_hz=10.0)
        made.append(Case("fibres, 10 Hz, 16 um a frame", moments(slow, "fibres", 160, count), context=slow))
        dim = replace(rig, instrument=replace(rig.instrument, light_dn=8.0))
        made.append(Case("nuclei, a tenth of the light", moments(dim, "nuclei", 100, count), context=dim))
    return made


def judge(item: Moment, answer: Image) -> Judgement:
    """Part of the image that the focal plane does not explain; and the haze over it, as a share of white."""
    side = len(item.in_focus)
    inside = disc(side, USED_DIAMETER * side)
    seen, true = (cv2.GaussianBlur(image, (0, 0), SMOOTHING_PX)[inside] for image in (answer, item.in_focus))
    rho = float(np.corrcoef(seen, true)[0, 1])
    gain = rho * float(seen.std() / true.std())
    haze = float(seen.mean() - gain * true.mean()) / (gain * float(np.quantile(true, 0.999)))
    return Judgement(unexplained(seen, true), details={"haze": haze})


def _ours(mode: Mode, *, row_reference: bool = False) -> Callable[[Case], Callable[[Moment], Image]]:
    def prepare(case: Case) -> Callable[[Moment], Image]:
        rig = case.context
        sectioner = Sectioner(rig.calibration, rig.instrument.frame_shape, row_reference=row_reference)
        out = np.empty((sectioner.side, sectioner.side), np.float32)

        def image(item: Moment) -> Image:
            return sectioner.section(item.raw, item.following if mode is Mode.ELSA else item.raw, mode, out)

        return image

    return prepare


class Crop:
    """Both views at whole pixels, as the paper extracts them: no rotation, no scale, no gain.

    Parameters
    ----------
    rig : SimulatedRig
        Whose centres are known.
    """

    def __init__(self, rig: SimulatedRig) -> None:
        sectioner = Sectioner(rig.calibration, rig.instrument.frame_shape)
        side = sectioner.side
        self.inside = sectioner.inside
        self.views = []
        for centre in (rig.instrument.confocal_centre, rig.instrument.residual_centre):
            top, left = (round(c - (side - 1) / 2) for c in centre)
            self.views.append(np.s_[top : top + side, left : left + side])
        assert rig.calibration.background is not None
        self.background = rig.calibration.background
        self.background_dn = np.rint(self.background).astype(np.uint8)


def _saturating(case: Case) -> Callable[[Moment], Image]:
    crop = Crop(case.context)
    left, right = crop.views

    def subtract(item: Moment) -> Image:
        clean = cv2.subtract(item.raw, crop.background_dn)
        return np.asarray(cv2.subtract(clean[left], clean[right]) * crop.inside, np.float32)

    return subtract


def _whole_pixels(case: Case) -> Callable[[Moment], Image]:
    crop = Crop(case.context)
    left, right = crop.views

    def subtract(item: Moment) -> Image:
        clean = np.subtract(item.raw, crop.background, dtype=np.float32)
        return np.asarray((clean[left] - clean[right]) * crop.inside, np.float32)

    return subtract


METHODS = (
    Method("ELS+, signed", Role.DEFAULT, _ours(Mode.ELS)),
    Method("ELS+, saturating", Role.PAPER, _saturating),
    Method("ELS+, signed, whole pixels", Role.OPTION, _whole_pixels),
    Method("ELS+, signed, row reference", Role.OPTION, _ours(Mode.ELS, row_reference=True)),
    Method("ELSA", Role.OPTION, _ours(Mode.ELSA)),
    Method("LS", Role.OPTION, _ours(Mode.LS)),
)

BENCHMARK = Benchmark(
    name="sectioning",
    question="How to subtract the residual view",
    error_label="part of the image that the focal plane does not explain",
    cases=_cases,
    methods=METHODS,
    judge=judge,
    remarks=(
        "Whole-pixel crops cost less: they bring the residual neither onto the confocal view nor to its brightness. "
        "LS is the cheapest because it subtracts nothing. The row reference takes the camera's row noise off frames "
        "that have any; these have none, and the time is that of the test for it."
    ),
)
