"""The weight of the residual in ELS+: one, and the best with the truth known.

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
from napari_elsplus.simulation.model.axial_response import LINE_MODELS
from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.simulation.specimen.scenes import Plane, Scene
from napari_elsplus.simulation.specimen.textures import Fibres, Mottle

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from benchmarks.rigs.simulated import SimulatedRig

    Image = NDArray[np.float32]

THICK_UM: Final = (15.0, 30.0, 50.0, 80.0)
"""Depths of the planes of a thick specimen, um."""
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
    """

    ls: Image
    residual: Image
    true: Image
    used: NDArray[np.bool_]

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
    return Views(ls, residual, true, used)


def best_weight(seen: Views) -> float:
    """Return the weight of the residual for which ELS+ correlates best with the focal plane: the truth is used."""
    weights = np.arange(0.0, MAX_WEIGHT, 0.02)
    return float(max(weights, key=lambda weight: seen.correlation(seen.ls - np.float32(weight) * seen.residual)))


def compare_weights(seen: Views) -> tuple[tuple[float, float], ...]:
    """Return weight and correlation with the focal plane: of LS (weight 0), ELS+ (1) and the best weight."""
    weights = 0.0, 1.0, best_weight(seen)
    return tuple((w, seen.correlation(seen.ls - np.float32(w) * seen.residual)) for w in weights)
