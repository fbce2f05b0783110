"""Clean and rough twins of the independent rig, and what any subtraction of the residual view could reach.

ELS+ of both is compared with the rig's own focal plane. Beside it stand ELS+ of frames without any noise, and the best
combination of LS and residual by columns that exists, fitted to the focal plane itself: no correction that is made of
what a calibration knows of the line along its length can exceed it. Two weights of the residual view alone are between
them: that which the calibrated bow asks for if all haze comes from one depth, and the best by the square of the place.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import cv2
import numpy as np
from numpy.polynomial import legendre
from scipy.special import erf

from benchmarks.rigs.row_rig import ROUGH, SPREAD, RowRecording, RowRig
from napari_elsplus.processing.images.sectioning import Mode, Sectioner, disc
from napari_elsplus.workflows.calibration import calibrate
from napari_elsplus.workflows.sectioning import section

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import Calibration

    Floats = NDArray[np.float64]

FIRST_SEED: Final = 411
"""Twins with smaller seeds were looked at while the software was written."""
DISTURBANCES: Final[dict[str, dict[str, Any]]] = {
    "clean": {},
    "rough": dict(ROUGH),
    "rough but for its bow": {**ROUGH, "bow": 0.0},
}
JUDGED: Final = 0.9
"""Part of the bundle's diameter in which images are compared, as the paper judges alignment."""
SMOOTH_PX: Final = 1.5
"""Standard deviation of the Gaussian with which images are smoothed before; chosen: about half a core."""
DEGREE: Final = 6
"""Of the polynomials along the line by which LS and residual are weighted; chosen: a bow is of the second."""
HAZE_UM: Final = 250.0
"""Depth for which the bow's weights are made; chosen: that of the nearer of the rig's two planes of haze."""
RIM_WEIGHTS: Final = np.linspace(0.6, 1.4, 81)
"""Weights of the residual view at the rim that are tried, over that in the middle."""
FRAMES: Final = 6
"""Frames of the resting scene that are averaged; chosen."""


class Twin(NamedTuple):
    """Correlations of a twin's images with its focal plane.

    Parameters
    ----------
    els, noise_free : float
        ELS+ of frames with and without noise.
    best : float
        The best weights by columns, fitted without noise.
    by_bow : float
        ELS+ whose residual is weighted as the calibrated bow asks for.
    rim_weight : float
        The best weight of the residual at the rim, over that in the middle.
    """

    els: float
    noise_free: float
    best: float
    by_bow: float
    rim_weight: float


class Twins(NamedTuple):
    """Twins of one seed: the rig, and the correlations by the name of the disturbances."""

    rig: RowRig
    found: dict[str, Twin]


def drawn(seed: int) -> RowRig:
    """Return a clean rig drawn at random: scene, offset, rotation, gain, light, halo and haze."""
    random = np.random.default_rng(seed)
    scene = str(random.choice(["nuclei", "fibres", "vessels"]))
    offset_rows = float(random.uniform(7, 13) * random.choice([-1, 1]))
    return RowRig(
        frames=0,
        seed=seed,
        scene=scene,
        right=(RowRig.left[0] + offset_rows, RowRig.right[1]),
        right_turn=float(random.uniform(-0.5, 0.5)),
        gain=float(random.uniform(0.9, 1.1)),
        signal=float(random.uniform(50, 110)),
        halo=float(random.uniform(0, 0.3)),
        haze=float(random.uniform(0.3, 0.9)),
    )


def compare_twins(seed: int, report: Callable[[str], None] = lambda _: None) -> Twins:
    """Calibrate the twins of a seed, and correlate their images with their focal planes."""
    rig, found = drawn(seed), {}
    for name, disturbances in DISTURBANCES.items():
        report(f"twin {seed}, {name}")
        found[name] = compare(replace(rig, **disturbances))
    return Twins(rig, found)


def compare(rig: RowRig) -> Twin:
    """Calibrate a rig from its files, and correlate the images of its resting scene with its focal plane."""
    recording = RowRecording(rig)
    with TemporaryDirectory() as name:
        folder = Path(name)
        recording.write(folder)
        calibration = calibrate(
            line=folder / "line.tif",
            sweep=folder / "sweep.tif",
            volts=folder / "sweep_volts.csv",
            bundle=folder / "transmission.tif",
            background=folder / "background.tif",
            bundle_um=rig.bundle_um,
            line_periods_per_frame=rig.line_periods_per_frame,
        ).calibration
    light, dark = recording.scanned(0), recording.autofluorescence()
    frames = np.stack([recording.expose(dark + light) for _ in range(FRAMES)])
    bare = Sectioner(calibration.model_copy(update={"background": None}), rig.shape)
    ls, els = (image(light.astype(np.float32)).copy() for image in (bare.ls, bare.els))
    focal = np.asarray(rig.signal * recording.focal(0, "left"), np.float32)
    wanted = cv2.getRectSubPix(focal, (bare.side, bare.side), (rig.left[1], rig.left[0]))
    noisy_ls, noisy = (np.mean(list(section(frames, calibration, mode)), axis=0) for mode in (Mode.LS, Mode.ELS))
    judged = disc(bare.side, JUDGED * rig.diameter)
    smooth = partial(cv2.GaussianBlur, ksize=(0, 0), sigmaX=SMOOTH_PX)
    images = (smooth(np.asarray(image, np.float32))[judged] for image in (wanted, noisy_ls, noisy, ls, els))
    truth, noisy_ls, noisy, ls, els = images
    along = np.broadcast_to((np.arange(bare.side) - (bare.side - 1) / 2) / rig.radius, judged.shape)[judged]
    terms = legendre.legvander(along, DEGREE)
    design = np.concatenate([terms * image[:, None] for image in (ls, ls - els)], axis=1)
    design -= design.mean(axis=0)  # the weights of least squares are then those of the largest correlation
    best = design @ np.linalg.lstsq(design, truth - truth.mean(), rcond=None)[0]

    def correlation(image: Floats) -> float:
        return float(np.corrcoef(image, truth)[0, 1])

    def weighted(weight: Floats) -> float:
        return correlation(noisy_ls - weight * (noisy_ls - noisy))

    at_rim = [weighted(1 + (weight - 1) * along**2) for weight in RIM_WEIGHTS]
    return Twin(
        els=correlation(noisy),
        noise_free=correlation(els),
        best=correlation(best),
        by_bow=weighted(bow_weights(calibration, rig.slit_rows, along)),
        rim_weight=float(RIM_WEIGHTS[np.argmax(at_rim)]),
    )


def bow_weights(calibration: Calibration, slit_rows: float, along: Floats) -> Floats:
    """Return weights of the residual view that leave as much haze of a bowed line as of its middle.

    A bow moves the line off the slit of one view, and nearer to or farther from that of the other, which shows less or
    more of the haze that is to be subtracted.

    Parameters
    ----------
    calibration : Calibration
        With the slit offset and its line, the galvo map with its bow, and the scale.
    slit_rows : float
        The slit.
    along : numpy.ndarray
        Places along the line, 1 at the bundle's rim.
    """
    offset, galvo, optics = calibration.offset, calibration.galvo, calibration.optics
    assert offset is not None
    assert galvo is not None
    assert optics is not None
    assert optics.um_per_px is not None
    core_rows, halo_rows, share = offset.core_rows or 1.0, offset.halo_rows or 1.0, offset.halo_share or 0.0
    spread_rows, bow_rows = SPREAD * HAZE_UM / optics.um_per_px, (galvo.bow_rows or 0.0) * np.square(along)

    def haze(rows: Floats) -> Floats:
        total = np.zeros_like(along)
        for part, width_rows in ((1 - share, core_rows), (share, halo_rows)):
            scale = np.sqrt(2) * np.hypot(width_rows, spread_rows)
            total += part * (erf((rows + slit_rows / 2) / scale) - erf((rows - slit_rows / 2) / scale))
        return total

    middle = np.zeros_like(along)
    left = haze(middle) - haze(middle + offset.rows)
    return np.asarray((haze(bow_rows) - left) / haze(bow_rows + offset.rows))


def markdown(twins: Iterable[Twins]) -> str:
    """Return the correlations of twins as a Markdown table."""
    titles = "seed", "scene", "offset, rows", "halo", *(f"{name}: ELS+" for name in DISTURBANCES)
    lost = "lost by the rough", "without noise", "by the best weights"
    gained = "gained by the bow's weights", "best weight at the rim: clean", "rough"
    rows = [[*titles, *lost, *gained], ["---"] * (len(titles) + len(lost) + len(gained))]
    for rig, found in twins:
        clean, rough = found["clean"], found["rough"]
        rows.append(
            [str(rig.seed), rig.scene, f"{rig.right[0] - rig.left[0]:.1f}", f"{rig.halo:.2f}"]
            + [f"{twin.els:.4f}" for twin in found.values()]
            + [f"{one - other:.4f}" for one, other in zip(clean[: len(lost)], rough[: len(lost)], strict=True)]
            + [f"{rough.by_bow - rough.els:.4f}", *(f"{twin.rim_weight:.2f}" for twin in (clean, rough))]
        )
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)
