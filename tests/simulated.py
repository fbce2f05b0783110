"""Recordings of the simulated instrument, and where the probe was, for tests that need its motion within a frame."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.simulation.rendering.renderer import Renderer
from napari_elsplus.simulation.specimen.scenes import scene
from napari_elsplus.simulation.truth import true_calibration
from napari_elsplus.workflows.sectioning import RawPairs
from napari_elsplus.workflows.tracking import Pipeline

if TYPE_CHECKING:
    from napari_elsplus.simulation.specimen.trajectories import Trajectory

INSTRUMENT = Instrument.of("240hz")


class Followed(NamedTuple):
    pipeline: Pipeline
    times_s: np.ndarray
    """When the bundle's middle row was read."""
    positions_px: np.ndarray
    """Where the probe then was, camera px."""

    @property
    def found_px(self) -> np.ndarray:
        return np.array([(row.row_px, row.col_px) for row in self.pipeline.rows])


def followed(
    path: Trajectory, name: str, frames: int, *, dark: slice = slice(0), lost: slice = slice(0), finish: bool = True
) -> Followed:
    """A simulated recording, some frames of it dark or lost by the camera, tracked, and refined if asked for."""
    renderer = Renderer(INSTRUMENT, scene(name), path, seed=1)
    raw = np.stack([renderer.render(k) for k in range(frames)])
    raw[dark] = INSTRUMENT.black_dn
    numbers = np.delete(np.arange(frames), lost)
    pairs = RawPairs(raw[numbers], "els", numbers)
    optics = INSTRUMENT.optics
    calibration = true_calibration(INSTRUMENT, np.full(INSTRUMENT.frame_shape, INSTRUMENT.black_dn, np.float32))
    pipeline = Pipeline(calibration, INSTRUMENT.frame_shape)
    for k in range(len(pairs)):
        pipeline.tracking.skip(pairs.lost_before(k))
        pipeline.track(pairs(k)[0], k)
    if finish:
        pipeline.finish(pairs)
    times = (numbers + INSTRUMENT.confocal_centre[0] / optics.line_periods_per_frame) * optics.frame_period_s
    return Followed(pipeline, times, path.positions_um(times) / optics.um_per_px)
