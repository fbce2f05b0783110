"""The honeycomb of the cores: what each filter leaves of it, and what it takes from the image.

The scene is known where no fibre bundle has cut it up, so one number judges both: the part of the image that the scene
does not explain. Honeycomb left and detail kept are given beside it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from benchmarks.harness.agreement import unexplained
from benchmarks.harness.methods import Benchmark, Case, Judgement, Method, Role, TimedElsewhere
from benchmarks.harness.peers import peer
from benchmarks.rigs.simulated import SimulatedRig, simulated_rig
from napari_elsplus.instrument.optics import CORE_PITCH_UM
from napari_elsplus.processing.images.cores import GAUSSIAN_SIGMA_PITCHES, CoreFilter
from napari_elsplus.processing.images.sectioning import Sectioner, disc
from napari_elsplus.simulation.specimen.scenes import Scene, scene
from napari_elsplus.simulation.specimen.trajectories import Still
from napari_elsplus.workflows.sectioning import finishing

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Image = NDArray[np.float32]

_JUDGED_DIAMETER = 0.8


class View(NamedTuple):
    """An image through the bundle, and the scene on its pixels."""

    image: Image
    scene: Image
    pitch_px: float


class Bundle(NamedTuple):
    """Inputs from which a filter is prepared."""

    rig: SimulatedRig
    sectioner: Sectioner

    @property
    def pitch_px(self) -> float:
        """Core pitch in pixels."""
        return CORE_PITCH_UM / self.rig.um_per_px


def view(rig: SimulatedRig, sectioner: Sectioner, looked_at: Scene, seed: int) -> View:
    """Look at a place of a scene that has nothing out of focus; noise as ever."""
    random = np.random.default_rng(seed)
    place = random.uniform(-2000, 2000, 2)
    scene = looked_at.in_focus()
    raw = rig.recording(scene, Still(*place), 1, seed=seed)[0]
    axis = (np.arange(sectioner.side) - (sectioner.side - 1) / 2) * rig.um_per_px
    truth = scene.planes[0].texture.sample(axis + place[0], axis + place[1])
    return View(sectioner.ls(raw), np.asarray(truth, np.float32), CORE_PITCH_UM / rig.um_per_px)


def _cases(quick: bool) -> list[Case]:
    made = []
    for preset, name in (("240hz", "fibres"), ("240hz", "nuclei"), ("120hz", "fibres"))[: 1 if quick else None]:
        rig = simulated_rig(preset)
        bundle = Bundle(rig, Sectioner(rig.calibration, rig.instrument.frame_shape))
        items = [view(rig, bundle.sectioner, scene(name, k), k) for k in range(1 if quick else 4)]
        made.append(Case(f"{name}, {bundle.pitch_px:.2g} px per core", items, context=bundle))
    return made


def judge(item: View, answer: Image) -> Judgement:
    """Part of the image that the scene does not explain; honeycomb left; detail kept."""
    side = len(answer)
    inside = disc(side, _JUDGED_DIAMETER * side)
    window = np.outer(np.hanning(side) ** 2, np.hanning(side) ** 2)
    seen, before, true = (np.fft.rfft2((x - x[inside].mean()) * window) for x in (answer, item.image, item.scene))
    pitches = np.hypot(np.fft.fftfreq(side)[:, None], np.fft.rfftfreq(side)) * item.pitch_px
    ring = np.abs(pitches - 2 / np.sqrt(3)) < 0.1
    detail, coarse = (pitches > 1 / 6) & (pitches < 1 / 3), (pitches > 1 / 40) & (pitches < 1 / 15)

    def gain(image: NDArray[np.complex128], band: NDArray[np.bool_]) -> float:
        return float((image * true.conj())[band].real.sum() / (np.abs(true[band]) ** 2).sum())

    left = np.abs(seen[ring]).sum() / gain(seen, coarse) / (np.abs(before[ring]).sum() / gain(before, coarse))
    kept = gain(seen, detail) / gain(seen, coarse)
    return Judgement(
        unexplained(answer[inside], item.scene[inside]), details={"honeycomb left": float(left), "detail kept": kept}
    )


def _ours(cores: CoreFilter, *, flat_field: bool = False) -> Callable[[Case], Callable[[View], Image]]:
    def prepare(case: Case) -> Callable[[View], Image]:
        finish = finishing(case.context.rig.calibration, case.context.sectioner, cores=cores, flat_field=flat_field)
        return lambda item: finish(item.image.copy())  # flat-fielding changes its argument

    return prepare


def _interpolation(case: Case) -> Callable[[View], TimedElsewhere]:
    other, bundle = peer("PyFibreBundle"), case.context
    flat, middle = bundle.rig.calibration.flat, (bundle.sectioner.side - 1) / 2
    other(
        "calibrate_interpolation", flat=flat, pitch=bundle.pitch_px, centre=middle, radius=middle,
        side=bundle.sectioner.side,
    )  # fmt: skip
    return lambda item: other("interpolate", image=item.image)


def _edge_filter(case: Case) -> Callable[[View], TimedElsewhere]:
    other = peer("PyFibreBundle")
    other("calibrate_edge_filter", side=case.context.sectioner.side, pitch=case.context.pitch_px)
    return lambda item: other("edge_filter", image=item.image)


def _gaussian(case: Case) -> Callable[[View], TimedElsewhere]:
    other, sigma = peer("PyFibreBundle"), GAUSSIAN_SIGMA_PITCHES * case.context.pitch_px
    return lambda item: other("gaussian", image=item.image, sigma=sigma)


METHODS = (
    Method("none", Role.DEFAULT, _ours(CoreFilter.NONE)),
    Method("median 3x3", Role.PAPER, _ours(CoreFilter.MEDIAN)),
    Method("Gaussian", Role.OPTION, _ours(CoreFilter.GAUSSIAN)),
    Method("Gaussian, flat-fielded", Role.OPTION, _ours(CoreFilter.GAUSSIAN, flat_field=True)),
    Method("interpolation", Role.OPTION, _ours(CoreFilter.INTERPOLATE)),
    Method("PyFibreBundle Gaussian", Role.PEER, _gaussian),
    Method("PyFibreBundle edge filter", Role.PEER, _edge_filter),
    Method("PyFibreBundle interpolation", Role.PEER, _interpolation),
)

BENCHMARK = Benchmark(
    name="cores",
    question="How to be rid of the core pattern",
    error_label="part of the image that the scene does not explain",
    cases=_cases,
    methods=METHODS,
    judge=judge,
    remarks=(
        "No filter is the default, as the raw numbers are then what the camera saw; it is on the front because it "
        "costs nothing. Which filter to take is what this chart is for."
    ),
)
