"""The weight of the residual in ELS+: one, by evidence for an image or its regions, and the best with the truth known.

Scenes are fibres in contact with the probe before fibres at one depth, or at several, and a ground. Every image is
judged by its correlation with the focal plane alone, after the cores were smoothed away.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING, Final, NamedTuple

import cv2
import numpy as np

from benchmarks.rigs.simulated import measured
from napari_elsplus.processing.analysis.image_quality import USED_DIAMETER
from napari_elsplus.processing.images.sectioning import Sectioner, disc
from napari_elsplus.simulation.accuracy import SMOOTHING_PX
from napari_elsplus.simulation.model.axial_response import LINE_MODELS, line_response
from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.simulation.specimen.scenes import Plane, Scene
from napari_elsplus.simulation.specimen.textures import Fibres, Mottle

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from benchmarks.rigs.simulated import SimulatedRig

    Image = NDArray[np.float32]
    Floats = NDArray[np.float64]

THICK_UM: Final = (15.0, 30.0, 50.0, 80.0)
"""Depths of the planes of a thick specimen, um."""
PRIOR_SIGMA: Final = 0.2
"""Standard deviation of the weight about 1 before an image is seen; chosen on seed 3 of 0.1, 0.2 and 0.4."""
BLOCKS: Final = 8
"""Regions along each side of the image for the weight's evidence: of some 70 um, three times the haze's structure."""
MAX_WEIGHT: Final = 2.5
"""Largest weight that is tried with the truth known."""


class Views(NamedTuple):
    """Smoothed views of one scene.

    Parameters
    ----------
    ls, residual, true : numpy.ndarray
        (n, n) float32: confocal and residual view, and the confocal view of the focal plane alone without noise.
    used : numpy.ndarray
        (n, n) bool: the pixels that are compared.
    leak : float
        In-focus light in the residual view over that in the confocal one.
    ls_noise : float
        Variance of the confocal view by shot and read noise, squared grey levels.
    """

    ls: Image
    residual: Image
    true: Image
    used: NDArray[np.bool_]
    leak: float
    ls_noise: float

    def correlation(self, image: Image) -> float:
        """Return the correlation of an image (n, n) with the focal plane alone."""
        return float(np.corrcoef(image[self.used], self.true[self.used])[0, 1])


def hazy(depth_um: float | None, seed: int) -> Scene:
    """Return fibres in contact before fibres at a depth (None: at several, a thick specimen) and a ground at 200 um."""
    if depth_um is None:
        haze = [Plane(Fibres(per_mm2=40, seed=seed + 10 + k), z, brightness=0.4) for k, z in enumerate(THICK_UM)]
    else:
        haze = [Plane(Fibres(per_mm2=60, seed=seed + 10), depth_um, brightness=0.8)]
    return Scene((Plane(Fibres(seed=seed)), *haze, Plane(Mottle(seed=seed), depth_um=200, brightness=1.5)))


@cache
def rig(offset_um: float, state: str = "a", light: float = 1.0) -> SimulatedRig:
    """Return a calibrated rig with a slit offset, a line and a part of the usual light."""
    usual = Instrument.of("240hz", offset_um=-offset_um, line=LINE_MODELS[state])
    return measured(
        replace(usual, electrons_per_dn=light * usual.electrons_per_dn, read_noise_e=min(light, 1.0) * 12.0)
    )


def views(seen_by: SimulatedRig, scene: Scene, seed: int) -> Views:
    """Return the views of a scene by a rig at rest."""
    instrument = seen_by.instrument
    sectioner = Sectioner(seen_by.calibration, instrument.frame_shape)
    raw = seen_by.recording(scene, None, 1, seed=seed)[0]
    perfect = seen_by.recording(scene.in_focus(), None, 1, noise=False)[0]
    images = sectioner.ls(raw), sectioner.residual(raw), sectioner.ls(perfect)
    ls, residual, true = (cv2.GaussianBlur(np.nan_to_num(image), (0, 0), SMOOTHING_PX) for image in images)
    used = disc(sectioner.side, USED_DIAMETER * sectioner.diameter_px) & sectioner.subtracted
    line, slit_um = instrument.line, instrument.slit_um
    leak = line_response(0, instrument.offset_um, slit_um, line) / line_response(0, 0, slit_um, line)
    light_dn = float(ls[used].mean()) + instrument.black_dn + instrument.autofluorescence * instrument.light_dn
    per_pixel = light_dn / instrument.electrons_per_dn + (instrument.read_noise_e / instrument.electrons_per_dn) ** 2
    return Views(ls, residual, true, used, float(leak), per_pixel / (4 * np.pi * SMOOTHING_PX**2))


def best_weight(seen: Views) -> float:
    """Return the weight of the residual for which ELS+ correlates best with the focal plane: the truth is used."""
    weights = np.arange(0.0, MAX_WEIGHT, 0.02)
    return float(max(weights, key=lambda weight: seen.correlation(seen.ls - np.float32(weight) * seen.residual)))


def weight_by_evidence(seen: Views) -> float:
    """Return the posterior mean of the weight, one for the image."""
    confocal, residual = _block_covariances(seen)
    return _posterior(confocal.sum(), residual.sum(), 1.0, _scatter(confocal, residual) * np.count_nonzero(residual))


def weights_by_region(seen: Views) -> Image:
    """Return the posterior mean of the weight in each region, (n, n) float32, interpolated between their middles."""
    confocal, residual = _block_covariances(seen)
    whole, scatter = weight_by_evidence(seen), _scatter(confocal, residual)
    weights = np.array([_posterior(a, b, whole, scatter) for a, b in zip(confocal.flat, residual.flat, strict=True)])
    side = len(seen.ls)
    coarse = weights.reshape(confocal.shape).astype(np.float32)
    return np.asarray(cv2.resize(coarse, (side, side), interpolation=cv2.INTER_LINEAR))


def _block_covariances(seen: Views) -> tuple[Floats, Floats]:
    """Return the covariances of both views with the residual freed of its in-focus light, in each block.

    That image contains haze and noise only, so that the ratio of both is the weight by which the haze of the confocal
    view is predicted best by the residual, its noise included.
    """
    middle = [image - image[seen.used].mean() for image in (seen.ls, seen.residual)]
    haze = middle[1] - seen.leak * middle[0]
    edges = np.linspace(0, len(haze), BLOCKS + 1).astype(int)[:-1]

    def in_blocks(image: Image) -> Floats:
        whole = np.where(seen.used, image, 0).astype(np.float64)
        return np.asarray(np.add.reduceat(np.add.reduceat(whole, edges, axis=0), edges, axis=1))

    own_noise = in_blocks(np.full_like(haze, seen.leak * seen.ls_noise))
    return in_blocks(middle[0] * haze) + own_noise, in_blocks(middle[1] * haze)


def _scatter(confocal: Floats, residual: Floats) -> float:
    """Return the variance of a block's covariance with haze that the residual does not predict: chance correlation."""
    filled = residual != 0
    left = confocal[filled] - confocal.sum() / max(residual.sum(), 1e-9) * residual[filled]
    return float(np.mean(left**2))


def _posterior(confocal: float, residual: float, expected: float, variance: float) -> float:
    """Return the posterior mean of the weight from two covariances of this variance and the prior about a weight."""
    precision = residual**2 / variance
    return float((confocal * residual / variance + expected / PRIOR_SIGMA**2) / (precision + 1 / PRIOR_SIGMA**2))


WEIGHTS: Final[dict[str, Callable[[Views], float | Image]]] = {
    "0 (LS)": lambda _: 0.0,
    "1 (ELS+)": lambda _: 1.0,
    "by evidence": weight_by_evidence,
    "by evidence, by region": weights_by_region,
    "best, truth known": best_weight,
}
"""Weights of the residual that are compared, by name."""


def compare_weights(seen: Views) -> dict[str, tuple[float, float]]:
    """Return the mean weight and the correlation with the focal plane for each of :data:`WEIGHTS`."""
    chosen = {name: np.asarray(choose(seen), np.float32) for name, choose in WEIGHTS.items()}
    return {name: (float(w.mean()), seen.correlation(seen.ls - w * seen.residual)) for name, w in chosen.items()}
