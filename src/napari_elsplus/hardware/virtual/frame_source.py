"""Frames of the bench, cheap enough for real time: those of a closed path are rendered once and played again."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.simulation.rendering.renderer import Renderer
from napari_elsplus.simulation.specimen.trajectories import Still

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.simulation.model.instrument import Instrument
    from napari_elsplus.simulation.specimen.scenes import Scene
    from napari_elsplus.simulation.specimen.trajectories import Trajectory

    Frame = NDArray[np.uint8]

SAME_ROWS: Final = 0.05
"""Lines that are nowhere farther apart give the same frame, to less than its noise."""
STILL_FRAMES: Final = 64
EDGE_ROWS: Final = 0.5


@dataclass(frozen=True, slots=True)
class Circle:
    """The probe goes round in a circle, for ever.

    Parameters
    ----------
    diameter_um : float
        Of the circle.
    period_s : float
        Time for one round.
    """

    diameter_um: float = 500.0
    period_s: float = 1.0

    def positions_um(self, times_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Row and column at each time; the circle begins at 0, 0."""
        angle = 2 * np.pi * times_s / self.period_s
        return np.stack([np.sin(angle), 1 - np.cos(angle)], axis=1) * (self.diameter_um / 2)


class FrameSource:
    """Frames of one scene, path and setting of the camera.

    Parameters
    ----------
    instrument : Instrument
        Optics and camera.
    scene : Scene
        What lies before the probe.
    trajectory : Trajectory
        How it moves.
    seed : int
        Of the noise.
    ahead : bool
        Whether frames that come again are kept.
    """

    def __init__(self, instrument: Instrument, scene: Scene, trajectory: Trajectory, seed: int, *, ahead: bool) -> None:
        self._made_for = (instrument, scene, trajectory)
        self._renderer = Renderer(instrument, scene, trajectory, seed=seed)
        rounds = _frames_per_round(trajectory, instrument.optics.frame_rate_hz) if ahead else 0
        self._kept = np.empty((rounds, *instrument.frame_shape), np.uint8)
        self._is_kept = np.zeros(rounds, bool)
        self._rows = np.arange(instrument.frame_shape[0], dtype=np.float64)
        self._before = self._kept_for = np.full_like(self._rows, np.inf)
        centres = instrument.left_centre[0], instrument.right_centre[0]
        reach = instrument.diameter_px / 2 + EDGE_ROWS
        self._dark = (self._rows < min(centres) - reach) | (self._rows > max(centres) + reach)

    def shows(self, instrument: Instrument, scene: Scene, trajectory: Trajectory) -> bool:
        """Whether these are the frames wanted."""
        return self._made_for == (instrument, scene, trajectory)

    def render_ahead(self, line_rows: NDArray[np.float64]) -> None:
        """Render what will come again if the line goes on moving so; at least once, to have everything compiled."""
        first = np.empty(self._kept.shape[1:], np.uint8)
        for k in (0, *range(max(1, len(self._kept)))):  # a frame is kept once the line was the same before
            self.fill(k, first, line_rows)

    def fill(self, frame: int, out: Frame, line_rows: NDArray[np.float64]) -> None:
        """Fill a frame, with the line on those rows; where neither image lies it does not matter where the line is.

        While the line moves alike in every frame, frames are kept, and answered from memory when they come again.
        """
        seen = np.where(self._dark, self._rows, line_rows)
        if not _alike(seen, self._kept_for):
            steady = _alike(seen, self._before)
            self._before = seen
            if not (steady and len(self._kept)):
                self._renderer.render(frame, out, line_rows=seen)
                return
            self._kept_for = seen
            self._is_kept[:] = False
        place = frame % len(self._kept)
        if not self._is_kept[place]:
            self._renderer.render(frame, self._kept[place], line_rows=self._kept_for)
            self._is_kept[place] = True
        np.copyto(out, self._kept[place])


def _alike(a: NDArray[np.float64], b: NDArray[np.float64]) -> bool:
    return bool(np.abs(a - b).max() < SAME_ROWS)


def _frames_per_round(trajectory: Trajectory, rate_hz: float) -> int:
    """Frames after which the probe is where it was; 0 if it never is at the beginning of a frame."""
    if isinstance(trajectory, Still):
        return STILL_FRAMES
    if isinstance(trajectory, Circle):
        frames = trajectory.period_s * rate_hz
        return round(frames) if abs(frames - round(frames)) < 1e-3 else 0
    return 0
