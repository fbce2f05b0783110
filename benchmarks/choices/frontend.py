"""From a raw frame to the image that is tracked: one fused pass against chains of library calls.

All chains make an image of about 250 pixels; each is held against the focal plane of the scene on its own pixels.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, NamedTuple

import cv2
import numpy as np

from benchmarks.choices.sectioning import Crop
from benchmarks.harness.agreement import unexplained
from benchmarks.harness.methods import Benchmark, Case, Judgement, Method, Role
from benchmarks.rigs.simulated import simulated_rig
from napari_elsplus.processing.images.sectioning import Sectioner
from napari_elsplus.processing.tracking.front_end.front_end import FrontEnd
from napari_elsplus.processing.tracking.template_tracking import SIDE_PX, takes_median
from napari_elsplus.simulation.specimen.scenes import scene
from napari_elsplus.simulation.specimen.trajectories import Still
from napari_elsplus.workflows.sectioning import finishing

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Image = NDArray[np.float32]

_JUDGED_UM = 250.0
"""Radius in which images are judged, of the bundle's 310 um."""
_SMOOTHING_UM = 4.0


class Raw(NamedTuple):
    """A raw frame, and where the probe rested on which scene."""

    frame: NDArray[np.uint8]
    name: str
    place_um: tuple[float, float]


class Small(NamedTuple):
    """An image for tracking: its pixel, and the row and column of the bundle's centre."""

    image: Image
    um_per_px: float
    centre: tuple[float, float]


def _cases(quick: bool) -> list[Case]:
    made = []
    for preset, name in (("240hz", "fibres"), ("240hz", "nuclei"), ("120hz", "fibres"))[: 1 if quick else None]:
        rig = simulated_rig(preset)
        random = np.random.default_rng(0)
        items = []
        for k in range(1 if quick else 4):
            row, col = random.uniform(-1000, 1000, 2)
            items.append(Raw(rig.recording(scene(name), Still(row, col), 1, seed=k)[0], name, (row, col)))
        made.append(Case(f"{name}, {preset}", items, context=rig))
    return made


@cache
def _focal_plane(
    name: str, place_um: tuple[float, float], um_per_px: float, centre: tuple[float, float], side: int
) -> Image:
    rows, cols = (
        np.asarray((np.arange(side) - c) * um_per_px + p, np.float64) for c, p in zip(centre, place_um, strict=True)
    )
    return scene(name).planes[0].texture.sample(rows, cols)


def judge(item: Raw, answer: Small) -> Judgement:
    """Part of the image that the focal plane does not explain."""
    side, um = len(answer.image), answer.um_per_px
    true = _focal_plane(item.name, item.place_um, um, answer.centre, side)
    y, x = (np.arange(side) - c for c in answer.centre)
    inside = np.hypot(y[:, None], x) * um < _JUDGED_UM
    seen, expected = (cv2.GaussianBlur(image, (0, 0), _SMOOTHING_UM / um)[inside] for image in (answer.image, true))
    return Judgement(unexplained(seen, expected))


def _fused(case: Case) -> Callable[[Raw], Small]:
    rig = case.context
    front_end = FrontEnd(rig.calibration, rig.instrument.frame_shape)
    grid = front_end.grid
    out = np.zeros((grid.side, grid.side), np.float32)
    return lambda item: Small(front_end.image(item.frame, out), grid.binning * rig.um_per_px, grid.centre)


def _small(image: Image | NDArray[np.uint8], um_per_px: float) -> Small:
    scale = len(image) / SIDE_PX
    small = cv2.resize(image, (SIDE_PX, SIDE_PX), interpolation=cv2.INTER_AREA)
    return Small(np.asarray(small, np.float32), um_per_px * scale, ((SIDE_PX - 1) / 2,) * 2)


def papers(case: Case) -> Callable[[NDArray[np.uint8]], Small]:
    """Prepare the paper's chain as it is written in OpenCV, in eight bits; the image is converted at the end."""
    um, chain = case.context.um_per_px, papers_chain(case)
    return lambda frame: _small(chain(frame), um)


def _papers(case: Case) -> Callable[[Raw], Small]:
    make = papers(case)
    return lambda item: make(item.frame)


def papers_chain(case: Case, *, down_sampled: bool = False) -> Callable[[NDArray[np.uint8]], NDArray[np.uint8]]:
    """Prepare the same, in eight bits to the end; with a median where the bundle is finely sampled, as in the paper."""
    crop, rig = Crop(case.context), case.context
    left, right = crop.views
    median = takes_median(rig.calibration.bundle.diameter_px)

    def chain(frame: NDArray[np.uint8]) -> NDArray[np.uint8]:
        clean = cv2.subtract(frame, crop.background_dn)
        image = cv2.subtract(clean[left], clean[right])
        if median:
            image = cv2.medianBlur(image, 3)
        if down_sampled:
            image = cv2.resize(image, (SIDE_PX, SIDE_PX), interpolation=cv2.INTER_AREA)
        return np.asarray(image, np.uint8)

    return chain


def _floats(case: Case) -> Callable[[Raw], Small]:
    crop, um = Crop(case.context), case.context.um_per_px
    left, right = crop.views

    def chain(item: Raw) -> Small:
        clean = np.subtract(item.frame, crop.background, dtype=np.float32)
        return _small(cv2.medianBlur(clean[left] - clean[right], 3), um)

    return chain


def _sectioned(case: Case) -> Callable[[Raw], Small]:
    rig = case.context
    sectioner = Sectioner(rig.calibration, rig.instrument.frame_shape)
    finish = finishing(rig.calibration, sectioner, flat_field=True)
    out = np.empty((sectioner.side, sectioner.side), np.float32)
    return lambda item: _small(finish(sectioner.els(item.frame, out)), rig.um_per_px)


METHODS = (
    Method("fused", Role.DEFAULT, _fused),
    Method("OpenCV, saturating", Role.PAPER, _papers),
    Method("numpy and OpenCV, float32, median", Role.OPTION, _floats),
    Method("full-resolution ELS+, flat, resize", Role.OPTION, _sectioned),
)

BENCHMARK = Benchmark(
    name="frontend",
    question="From a raw frame to the image that is tracked",
    error_label="part of the image that the focal plane does not explain",
    cases=_cases,
    methods=METHODS,
    judge=judge,
)
