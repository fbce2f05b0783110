"""Frames of the bench, cheap enough for real time: those of a closed path are rendered once and played again.

Where the specimen bleaches no frame recurs, but the light on the cores does, apart from what is lost: it is computed
once, and each frame has pixels and noise of its own. What belongs to a moving probe is remembered between starts, too
(:mod:`remembered_frames`).
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.hardware.virtual.remembered_frames import frames_key, recall_frames, remember_frames
from napari_elsplus.simulation.rendering.renderer import Renderer
from napari_elsplus.simulation.specimen.trajectories import Circle, Still

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.simulation.model.instrument import Instrument
    from napari_elsplus.simulation.specimen.scenes import Scene
    from napari_elsplus.simulation.specimen.trajectories import Trajectory

    Frame = NDArray[np.uint8]
    Light = NDArray[np.float32]

SAME_LINE_ROWS: Final = 0.05
"""Rows; lines that differ by less give the same frame to within its noise (chosen: a sixtieth of the smallest slit)."""
STILL_FRAMES: Final = 64
"""Frames kept of a scene at rest; chosen: their noise does not recur visibly."""
EDGE_ROWS: Final = 0.5
"""Rows beyond the bundle's radius in which the line still matters; chosen: half a pixel."""


class SceneFrames:
    """Frames of one scene, trajectory and camera setting.

    Parameters
    ----------
    instrument : Instrument
        Optics and camera.
    scene : Scene
        Specimen in front of the probe.
    trajectory : Trajectory
        Motion of the probe.
    seed : int
        Seed of the noise.
    ahead : bool
        Keep what recurs.
    """

    def __init__(self, instrument: Instrument, scene: Scene, trajectory: Trajectory, seed: int, *, ahead: bool) -> None:
        self._made_for = (instrument, scene, trajectory)
        if isinstance(trajectory, Circle):
            trajectory = trajectory.closed(instrument.optics.frame_rate_hz)
        self._renderer = Renderer(instrument, scene, trajectory, seed=seed)
        self._bleaches = bool(instrument.imperfections.bleaching_percent) and not scene.transmission
        moves = not isinstance(trajectory, Still)
        recurs = ahead and (moves or not self._bleaches)  # at rest, light is known from the frame before
        rounds = _frames_per_round(trajectory, instrument.optics.frame_rate_hz) if recurs else 0
        self._key = frames_key(*self._made_for, seed) if moves and rounds else ""
        self._kept: Frame | Light
        if self._bleaches:
            self._kept = np.empty((rounds, *self._renderer.light_shape), np.float32)
        else:
            self._kept = np.empty((rounds, *instrument.frame_shape), np.uint8)
        self._is_kept = np.zeros(rounds, bool)
        self._rows = np.arange(instrument.frame_shape[0], dtype=np.float64)
        self._before = self._kept_for = np.full_like(self._rows, np.inf)
        centres = instrument.confocal_centre[0], instrument.residual_centre[0]
        reach = instrument.diameter_px / 2 + EDGE_ROWS
        self._dark = (self._rows < min(centres) - reach) | (self._rows > max(centres) + reach)

    def shows(self, instrument: Instrument, scene: Scene, trajectory: Trajectory) -> bool:
        """Return True if the frames are those of an instrument, a scene and a trajectory."""
        return self._made_for == (instrument, scene, trajectory)

    def render_ahead(self, line_rows: NDArray[np.float64]) -> None:
        """Recall or render what recurs while the line is on `line_rows`; at least one frame, to compile all."""
        seen = self._seen(line_rows)
        self._renderer.render(0, line_rows=seen)
        if len(self._kept) and not _alike(seen, self._kept_for):
            self._keep_for(seen)
        if self._is_kept.all():
            return
        recalled = recall_frames(self._key, self._kept, len(seen), partial(_alike, seen)) if self._key else None
        if recalled is not None:
            self._kept = recalled
            self._is_kept[:] = True
            return
        for place in np.flatnonzero(~self._is_kept).tolist():
            self._keep(place)
        if self._key:
            remember_frames(self._key, self._kept_for, self._kept)

    def fill(self, frame: int, out: Frame, line_rows: NDArray[np.float64], *, lit_frames: int | None = None) -> None:
        """Fill a frame; outside both images the line's row does not matter.

        While the line moves alike in every frame, what recurs is kept, and taken from memory when it does.

        Parameters
        ----------
        frame : int
            Number of the frame in its stream.
        out : numpy.ndarray
            (rows, cols) uint8.
        line_rows : numpy.ndarray
            Row of the confocal view on which the line is, for each row of the frame.
        lit_frames : int, optional
            Number of frames for which the specimen was lit before; `frame` if not given.
        """
        seen = self._seen(line_rows)
        if not _alike(seen, self._kept_for):
            steady = _alike(seen, self._before)
            self._before = seen
            if not (steady and len(self._kept)):
                self._renderer.render(frame, out, line_rows=seen, lit_frames=lit_frames)
                return
            self._keep_for(seen)
        place = frame % len(self._kept)
        if not self._is_kept[place]:
            self._keep(place)
        if self._bleaches:
            self._renderer.render(frame, out, light=self._kept[place], lit_frames=lit_frames)
        else:
            np.copyto(out, self._kept[place])

    def _seen(self, line_rows: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the line's rows, those where they do not matter as of an ideal scan."""
        return np.where(self._dark, self._rows, line_rows)

    def _keep_for(self, seen: NDArray[np.float64]) -> None:
        """Keep what recurs while the line is on `seen` from now on."""
        self._before = self._kept_for = seen
        self._is_kept[:] = False

    def _keep(self, place: int) -> None:
        """Render a frame that recurs, or the light of those that differ by bleaching and noise alone."""
        if self._bleaches:
            self._renderer.core_light(place, self._kept[place], line_rows=self._kept_for)
        else:
            self._renderer.render(place, self._kept[place], line_rows=self._kept_for)
        self._is_kept[place] = True


def _alike(a: NDArray[np.float64], b: NDArray[np.float64]) -> bool:
    return bool(np.abs(a - b).max() < SAME_LINE_ROWS)


def _frames_per_round(trajectory: Trajectory, rate_hz: float) -> int:
    """Return the frames after which a probe at rest or on a closed circle is at the same place; 0 on other paths."""
    if isinstance(trajectory, Still):
        return STILL_FRAMES
    if isinstance(trajectory, Circle):
        return round(trajectory.period_s * rate_hz)
    return 0
