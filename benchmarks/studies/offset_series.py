"""ELS+ of several slit offsets of one place, combined, against that of the best offset alone."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from benchmarks.studies.subtraction import rig, views
from napari_elsplus.simulation.model.axial_response import line_response

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from napari_elsplus.simulation.model.instrument import Instrument
    from napari_elsplus.simulation.specimen.scenes import Scene

DEPTHS_UM: Final = np.linspace(15.0, 250.0, 60)
"""Depths of the haze that the combination of offsets is to suppress, um."""
RIDGE: Final = 1e-3
"""Noise of one frame over the haze, as powers, for the combination of offsets; chosen on seed 3 of 1e-4 to 1e-2."""


def compare_offsets(
    offsets_um: Sequence[float], scene: Scene, state: str, light: float, seed: int
) -> tuple[list[float], float, float]:
    """Return correlations with the focal plane: of each offset alone, of their series, and of the best combination.

    Each offset alone has the light of the whole series, which gives each of its frames an equal part. The series is the
    mean confocal view minus residuals, weighted as :func:`offset_weights` states; the best combination fits these
    weights to the truth.
    """
    alone, series = [], []
    for offset_um in offsets_um:
        bright = views(rig(offset_um, state, light * len(offsets_um)), scene, seed)
        alone.append(bright.correlation(bright.ls - bright.residual))
        series.append(views(rig(offset_um, state, light), scene, seed + 1))
    used = np.logical_and.reduce([seen.used for seen in series])
    true = np.mean([seen.true for seen in series], axis=0)[used]
    images = [np.mean([seen.ls for seen in series], axis=0), *(seen.residual for seen in series)]
    pixels = np.stack([image[used] - image[used].mean() for image in images], axis=1)
    combined = pixels @ offset_weights(offsets_um, rig(offsets_um[0], state, light).instrument)
    best = pixels @ np.linalg.lstsq(pixels, true - true.mean(), rcond=None)[0]
    return alone, float(np.corrcoef(combined, true)[0, 1]), float(np.corrcoef(best, true)[0, 1])


def offset_weights(offsets_um: Sequence[float], instrument: Instrument) -> NDArray[np.float64]:
    """Return the weights of the mean confocal view and of each residual that suppress haze from all depths best.

    They minimise the mean square of the axial response over :data:`DEPTHS_UM` and the noise, the response in focus
    held at one.
    """
    line, slit_um = instrument.line, instrument.slit_um
    places = [0.0, *offsets_um]
    in_focus = np.array([float(line_response(0, place, slit_um, line)) for place in places])
    responses = np.stack([line_response(DEPTHS_UM, place, slit_um, line) for place in places], axis=1) / in_focus[0]
    in_focus /= in_focus[0]
    noise = RIDGE * np.diag([1 / len(offsets_um), *np.ones(len(offsets_um))])
    weights = np.linalg.solve(responses.T @ responses / len(DEPTHS_UM) + noise, in_focus)
    return np.asarray(weights / (weights @ in_focus))
