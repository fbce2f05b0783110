"""The right view laid onto the left: by its cores, by the outlines, by correlation, by another project's locator."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import cv2
import numpy as np
from skimage.filters import threshold_otsu
from skimage.registration import phase_cross_correlation

from benchmarks.harness.methods import Benchmark, Case, Judgement, Method, Role, TimedElsewhere, plain
from benchmarks.harness.peers import peer
from benchmarks.rigs.random_rigs import Rig
from napari_elsplus.errors import MeasurementError
from napari_elsplus.processing.calibration.bundle.location import locate_pair
from napari_elsplus.processing.calibration.measurements import measure_pair

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

WRONG_PX = 0.5
"""Half a pixel at the rim leaves an embossed honeycomb in the difference."""


class Lit(NamedTuple):
    """A frame of a bundle lit from its far end, and what maps its right view onto its left."""

    frame: NDArray[np.uint8]
    rig: Rig


def _cases(quick: bool) -> list[Case]:
    seeds = range(2 if quick else 10)
    lights = (("bright, 1000 electrons", 1000.0), ("dim, 30 electrons", 30.0))[: 1 if quick else None]
    made = []
    for name, photons in lights:
        rigs = [Rig.draw(seed).with_photons(photons) for seed in seeds]
        made.append(Case(name, [Lit(rig.bundle(1)[0], rig) for rig in rigs]))
    return made


def judge(item: Lit, answer: Floats) -> Judgement:
    """Largest misplacement of the right view, in the middle and at four points of the rim."""
    rim = 0.45 * item.rig.diameter_px * np.array([(0, 0), (0, 1), (1, 0), (0, -1), (-1, 0)])
    places = np.column_stack([np.array(item.rig.right) + rim @ item.rig.left_to_right.T, np.ones(len(rim))])
    missed = places @ np.subtract(answer, item.rig.residual_to_confocal).T
    error = float(np.hypot(*missed.T).max())
    return Judgement(error, failed=not error <= WRONG_PX)


def by_cores(item: Lit) -> Floats:
    """Locate both discs, then match the cores."""
    return measure_pair([item.frame]).alignment.residual_to_confocal


def by_circles(item: Lit) -> Floats:
    """Locate both discs and take their centres."""
    left, right = locate_pair(item.frame)
    return _shift(np.subtract(left.centre, right.centre))


def by_rows_and_columns(item: Lit) -> Floats:
    """Take the row and column with the most lit pixels, as the paper does."""
    lit = item.frame > threshold_otsu(item.frame)
    split = _split(item)
    left, right = (
        np.array([half.sum(axis=1).argmax(), half.sum(axis=0).argmax()], float)
        for half in (lit[:, :split], lit[:, split:])
    )
    return _shift(left - right - (0, split))


def by_phase(item: Lit) -> Floats:
    """scikit-image's phase correlation of the two halves, a twentieth of a pixel."""
    left, right = _halves(item)
    shift, _, _ = phase_cross_correlation(left, right, upsample_factor=20)
    return _shift(np.asarray(shift) - (0, item.frame.shape[1] - left.shape[1]))


def by_ecc(item: Lit) -> Floats:
    """OpenCV's ECC, affine, from the halves as they lie."""
    left, right = _halves(item)
    warp = np.eye(2, 3, dtype=np.float32)
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 60, 1e-5)
    try:
        _, warp = cv2.findTransformECC(left, right, warp, cv2.MOTION_AFFINE, criteria)
    except cv2.error as error:
        raise MeasurementError(f"ECC: {error.err}", "start nearer") from None
    swap = np.eye(3)[[1, 0, 2]]
    left_to_right = swap @ np.vstack([warp, (0, 0, 1)]) @ swap
    left_to_right[1, 2] += item.frame.shape[1] - left.shape[1]
    return np.asarray(np.linalg.inv(left_to_right)[:2], np.float64)


def _pyfibrebundle(_: Case) -> Callable[[Lit], TimedElsewhere]:
    other = peer("PyFibreBundle")

    def locate(item: Lit) -> TimedElsewhere:
        split = _split(item)
        left = other("find_bundle", image=item.frame[:, :split])
        right = other("find_bundle", image=item.frame[:, split:])
        shift = left.answer[:2] - right.answer[:2] - (0, split)
        return TimedElsewhere(_shift(shift), left.seconds + right.seconds)

    return locate


def _split(item: Lit) -> int:
    """Return the column between the views, which all but the first method are told."""
    return round((item.rig.left[1] + item.rig.right[1]) / 2)


def _halves(item: Lit) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Both views, of one size: from the left edge, and to the right edge of the frame."""
    width = min(_split(item), item.frame.shape[1] - _split(item))
    return item.frame[:, :width].astype(np.float32), item.frame[:, -width:].astype(np.float32)


def _shift(shift: Floats) -> Floats:
    return np.column_stack([np.eye(2), shift])


METHODS = (
    Method("cores", Role.DEFAULT, plain(by_cores), 6),
    Method("circles", Role.OPTION, plain(by_circles), 2),
    Method("most lit row and column", Role.PAPER, plain(by_rows_and_columns), 2),
    Method("scikit-image phase", Role.PEER, plain(by_phase), 2),
    Method("OpenCV ECC, affine", Role.PEER, plain(by_ecc), 6),
    Method("PyFibreBundle find_bundle", Role.PEER, _pyfibrebundle, 2),
)

BENCHMARK = Benchmark(
    name="pair",
    question="How the right view lies on the left",
    error_label="largest misplacement / px",
    cases=_cases,
    methods=METHODS,
    judge=judge,
    remarks=(
        "Rigs are drawn at random, half of them with a right view that is turned and scaled. All but the first two "
        "methods are given the column between the views. It is done once, while calibrating."
    ),
)
