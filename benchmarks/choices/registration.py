"""Registration of two frames: the tracker's link against templates, phase correlation, ECC and gradients.

The probe rests during each frame and jumps between frames, so that there is one true shift and no rolling shutter in
it. All methods are given the same flat-fielded tracking images.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import cv2
import numpy as np
from skimage.registration import phase_cross_correlation

from benchmarks.harness.methods import Benchmark, Case, Claim, Judgement, Method, Role, TimedElsewhere, plain
from benchmarks.harness.peers import peer
from benchmarks.rigs.simulated import SimulatedRig, StopAndGo, jumps, simulated_rig, tissue
from napari_elsplus.errors import MeasurementError
from napari_elsplus.processing.tracking.front_end.grid import Grid, lit_pixels
from napari_elsplus.processing.tracking.motion.motion_prior import MotionPrior
from napari_elsplus.processing.tracking.motion.rolling_shutter import Displacement, Velocity
from napari_elsplus.processing.tracking.registration.pair_registration import PairRegistration, PreparedFrame, Registrar
from napari_elsplus.processing.tracking.template_tracking import TEMPLATE_PX

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from napari_elsplus.simulation.specimen.scenes import Scene

    Image = NDArray[np.float32]

WRONG_PX = 3.0
"""Pixels of the tracking images. A shift this far off is no registration: the frame would lie in the wrong place."""
_PREDICTION_PX = 3.0
_VELOCITY_PX = 0.2
_PEER_OVERLAP = 0.15
"""Smallest overlap that scikit-image's masked correlation searches, part of the disc; chosen: all pairs have more."""


class Pair(NamedTuple):
    """Two images, how far the probe went from one to the other (row, col), and where it was expected."""

    earlier: Image
    later: Image
    moved: NDArray[np.float64]
    expected: NDArray[np.float64]


class Shift(NamedTuple):
    """A method's answer: displacement of the probe, and whether it stands by it."""

    row: float
    col: float
    claim: Claim = Claim.SURE


def pairs(scene: str, px: float, count: int, seed: int = 0) -> list[Pair]:
    """Pairs of tracking images of a scene, the probe that many tracking pixels apart in random directions."""
    rig = simulated_rig()
    path = jumps(count, px, rig, Grid.of(rig.calibration).binning, seed)
    return pairs_along(rig, tissue(scene, seed), path, seed, np.random.default_rng(seed))


def pairs_along(
    rig: SimulatedRig, looked_at: Scene, path: StopAndGo, seed: int, random: np.random.Generator
) -> list[Pair]:
    """Record two frames at each pair of resting places; where they are expected is drawn at random."""
    images = rig.tracking_images(rig.recording(looked_at, path, len(path.positions), seed=seed))
    places = path.positions / (Grid.of(rig.calibration).binning * rig.um_per_px)
    moved = places[1::2] - places[::2]
    expected = moved + random.normal(0, _PREDICTION_PX, moved.shape)
    return [Pair(*of) for of in zip(images[::2], images[1::2], moved, expected, strict=True)]


def _cases(quick: bool) -> list[Case]:
    count, names = (2, ("fibres",)) if quick else (16, ("fibres", "nuclei", "sparse"))
    return [
        Case(f"{name}, 20 px", pairs(name, 20.0, count), context=Grid.of(simulated_rig().calibration)) for name in names
    ]


def judge(pair: Pair, answer: Shift) -> Judgement:
    """Distance from the true displacement; a few pixels off is a failure."""
    row, col, claim = answer
    error = float(np.hypot(row - pair.moved[0], col - pair.moved[1]))
    return Judgement(error, failed=not error <= WRONG_PX, claim=claim)


class _Ours:
    """The tracker's registration, with both views kept as the tracker keeps them."""

    def __init__(self, case: Case) -> None:
        self._registrar = Registrar(case.context)
        self._earlier, self._later = self._registrar.view(), self._registrar.view()
        self._reach = 0.3 * case.context.diameter

    def predicted(self, pair: Pair) -> Shift:
        """Start at the prediction; search all shifts where the frames do not bear it out."""
        earlier, later = self._views(pair)
        motion = self._motion((float(pair.expected[0]), float(pair.expected[1])), _PREDICTION_PX)
        link = self._registrar.register(earlier, later, motion)
        if link is not None and link.observed and link.correlation > 0.9:
            return _shift(link)
        return _shift(self._registrar.register(earlier, later, motion, anywhere=True))

    def searched(self, pair: Pair) -> Shift:
        """Search all shifts."""
        return _shift(
            self._registrar.register(*self._views(pair), self._motion((0.0, 0.0), self._reach), anywhere=True)
        )

    def _motion(self, displacement: tuple[float, float], sigma_px: float) -> MotionPrior:
        at_rest, shutter = Velocity(0.0, 0.0), self._registrar.grid.shutter
        return MotionPrior.between(
            (at_rest, at_rest), Displacement(*displacement), (_VELOCITY_PX, _VELOCITY_PX), sigma_px, shutter
        )

    def _views(self, pair: Pair) -> tuple[PreparedFrame, PreparedFrame]:
        self._earlier.image[:], self._later.image[:] = pair.earlier, pair.later
        return self._registrar.prepare(self._earlier), self._registrar.prepare(self._later)


def _shift(link: PairRegistration | None) -> Shift:
    if link is None:
        raise MeasurementError("no shift is supported", "the frames show nothing in common")
    return Shift(-link.warp.b, -link.warp.d, Claim.SURE if link.observed else Claim.REFUSED)


def _template(pair: Pair) -> tuple[Image, float, float]:
    """Match the middle of the earlier image in the later one: correlations, whole-pixel shift of the content."""
    corner = (len(pair.earlier) - TEMPLATE_PX) // 2
    template = pair.earlier[corner : corner + TEMPLATE_PX, corner : corner + TEMPLATE_PX]
    scores = cv2.matchTemplate(pair.later, template, cv2.TM_CCOEFF_NORMED)
    col, row = cv2.minMaxLoc(scores)[3]
    return scores, row - corner, col - corner


def template_matching(pair: Pair) -> Shift:
    """Whole pixels, as the paper matches."""
    _, row, col = _template(pair)
    return Shift(-row, -col)


def template_with_parabola(pair: Pair) -> Shift:
    """Fractions of a pixel, from a parabola through the peak and its neighbours."""
    scores, row, col = _template(pair)
    corner = (len(pair.earlier) - TEMPLATE_PX) // 2
    at = int(row) + corner, int(col) + corner
    return Shift(-(row + _vertex(scores[:, at[1]], at[0])), -(col + _vertex(scores[at[0]], at[1])))


def _vertex(scores: Image, peak: int) -> float:
    if not 0 < peak < len(scores) - 1:
        return 0.0
    before, top, after = (float(score) for score in scores[peak - 1 : peak + 2])
    curvature = before - 2 * top + after
    return 0.5 * (before - after) / curvature if curvature < 0 else 0.0


def _opencv_phase(case: Case) -> Callable[[Pair], Shift]:
    side = case.context.side
    window = cv2.createHanningWindow((side, side), cv2.CV_32F)

    def register(pair: Pair) -> Shift:
        # the window is multiplied into the arguments where no padding is needed
        (col, row), _ = cv2.phaseCorrelate(pair.earlier.copy(), pair.later.copy(), window)
        return Shift(-row, -col)

    return register


def skimage_phase(pair: Pair) -> Shift:
    """scikit-image, a twentieth of a pixel."""
    (row, col), _, _ = phase_cross_correlation(pair.earlier, pair.later, upsample_factor=20)
    return Shift(float(row), float(col))


def _skimage_masked(case: Case) -> Callable[[Pair], Shift]:
    inside = lit_pixels(*case.context.spans())

    def register(pair: Pair) -> Shift:
        (row, col), _, _ = phase_cross_correlation(
            pair.earlier, pair.later, reference_mask=inside, moving_mask=inside, overlap_ratio=_PEER_OVERLAP
        )
        return Shift(float(row), float(col))

    return register


def ecc(pair: Pair) -> Shift:
    """OpenCV's enhanced correlation coefficient, started where the probe is expected."""
    warp = np.array([[1, 0, -pair.expected[1]], [0, 1, -pair.expected[0]]], np.float32)
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 1e-4)
    try:
        _, warp = cv2.findTransformECC(pair.earlier, pair.later, warp, cv2.MOTION_TRANSLATION, criteria)
    except cv2.error as error:
        raise MeasurementError(f"ECC: {error.err}", "start nearer") from None
    return Shift(-float(warp[1, 2]), -float(warp[0, 2]))


def gradient_pyramid(pair: Pair) -> Shift:
    """OpenCV's cv2.reg: gradients on a pyramid, started where the probe is expected."""
    gradient = cv2.reg.MapperGradShift()  # the pyramid refers to it without keeping it alive
    mapper = cv2.reg.MapperPyramid(gradient)
    start = cv2.reg.MapShift(np.array([-pair.expected[1], -pair.expected[0]]))
    found = mapper.calculate(pair.earlier, pair.later, start)
    col, row = cv2.reg.MapTypeCaster.toShift(found).getShift().ravel()
    return Shift(-float(row), -float(col))


def _pyfibrebundle(case: Case) -> Callable[[Pair], TimedElsewhere]:
    other, side = peer("PyFibreBundle"), case.context.side

    def register(pair: Pair) -> TimedElsewhere:
        (row, col, _), seconds = other(
            "find_shift", earlier=pair.earlier, later=pair.later, template=round(side / 4), reach=round(side / 2)
        )
        return TimedElsewhere(Shift(float(row), float(col)), seconds)

    return register


METHODS = (
    Method("link, predicted", Role.DEFAULT, lambda case: _Ours(case).predicted, 4),
    Method("link, searched", Role.OPTION, lambda case: _Ours(case).searched, 4),
    Method("template", Role.PAPER, plain(template_matching), 2),
    Method("template + parabola", Role.OPTION, plain(template_with_parabola), 2),
    Method("OpenCV phaseCorrelate", Role.PEER, _opencv_phase, 2),
    Method("OpenCV ECC, predicted", Role.PEER, plain(ecc), 2),
    Method("OpenCV cv2.reg, predicted", Role.PEER, plain(gradient_pyramid), 2),
    Method("scikit-image phase", Role.PEER, plain(skimage_phase), 2),
    Method("scikit-image masked", Role.PEER, _skimage_masked, 2),
    Method("PyFibreBundle", Role.PEER, _pyfibrebundle, 2),
)

BENCHMARK = Benchmark(
    name="registration",
    question="Which shift lies between two frames",
    error_label="error / px",
    cases=_cases,
    methods=METHODS,
    judge=judge,
    remarks=(
        "Predicted methods start about 3 px from the truth, as a track does; the others search. The link prepares both "
        "views here, in a stream only the later one."
    ),
)
