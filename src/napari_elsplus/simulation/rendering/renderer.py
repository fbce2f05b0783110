"""Render raw camera frames of a scene: cores, rolling shutter, two views, noise, eight bits.

Each core samples the scene at the time at which its camera row is read, in each view; the light that it receives
depends on the position of the laser line (:mod:`scan`). Cores are then spread over pixels and noise is added
(:mod:`sensor`).
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from napari_elsplus.errors import InputError
from napari_elsplus.simulation.model.imperfections import IDEAL
from napari_elsplus.simulation.rendering.disturbances import UNDISTURBED, UNFADED, Disturbances
from napari_elsplus.simulation.rendering.line_light import LineIllumination
from napari_elsplus.simulation.rendering.sampling import fade_cores, sample_cores
from napari_elsplus.simulation.rendering.scan import LineScan
from napari_elsplus.simulation.rendering.sensor import expose
from napari_elsplus.simulation.rendering.views import views
from napari_elsplus.simulation.specimen.layers import Layer, join_windows
from napari_elsplus.simulation.specimen.trajectories import Still, Trajectory, TurningTrajectory

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from napari_elsplus.simulation.model.instrument import Instrument
    from napari_elsplus.simulation.specimen.scenes import Scene

    Frame = NDArray[np.uint8]
    Light = NDArray[np.float32]


class Renderer:
    """Renders raw frames of a scene, as the instrument would record them.

    Parameters
    ----------
    instrument : Instrument
        Optics, bundle, camera.
    scene : Scene
        The specimen.
    trajectory : Trajectory
        Motion of the probe; at rest by default.
    seed : int
        Seed of the camera's noise; the same seed and frame index give the same frame.
    noise : bool
        False for frames without shot and read noise.

    Examples
    --------
    >>> from napari_elsplus.simulation.model.instrument import Instrument
    >>> from napari_elsplus.simulation.specimen.scenes import scene
    >>> renderer = Renderer(Instrument.of("240hz"), scene("uniform"))
    >>> frame = np.empty(renderer.frame_shape, np.uint8)
    >>> frame is renderer.render(0, frame)
    True
    >>> stalled = np.full(renderer.frame_shape[0], 250.0)  # the galvo rests: one bright line in each view
    >>> frame = renderer.render(0, line_rows=stalled)
    >>> int(frame[250].mean()) > 5 * int(frame[450].mean())
    True
    """

    def __init__(
        self,
        instrument: Instrument,
        scene: Scene,
        trajectory: Trajectory | None = None,
        *,
        seed: int = 0,
        noise: bool = True,
    ) -> None:
        self.instrument = instrument if noise else replace(instrument, electrons_per_dn=1e9, read_noise_e=0.0)
        self.scene = scene
        self.trajectory = Still() if trajectory is None else trajectory
        self.frame_shape = instrument.frame_shape
        self._seed = seed
        self._cores, *self._views = views(instrument)
        self._disturbances: Disturbances | None = None
        if instrument.imperfections != IDEAL:
            self._disturbances = Disturbances(instrument, seed, laser=not scene.transmission, of_camera=noise)
        self._scan = LineScan(instrument, scene, self._cores)
        reach_um = instrument.bundle.radius_um + abs(instrument.offset_um) / 2
        self._layers = [Layer(term.plane.texture, term.blur, reach_um) for term in self._scan.terms]
        self._samples, self._first = join_windows(self._layers)
        self._sizes = np.array([layer.size for layer in self._layers], np.int64)
        self._per_um = np.array([1 / layer.step_um for layer in self._layers], np.float64)
        jitter_rows = instrument.imperfections.line_jitter_rows
        self._light = LineIllumination(self._scan, self._views, self.frame_shape[0], jitter_rows)
        self._values = np.empty((2, len(self._cores.rows_um)), np.float32)
        self.light_shape = 2, 2, len(self._cores.rows_um)
        self._unfaded = np.empty(self.light_shape, np.float32)
        self._row_signal = np.zeros((2, 2 * self.frame_shape[1]), np.float32)

    def render(
        self,
        frame_index: int,
        out: Frame | None = None,
        *,
        line_rows: NDArray[np.float64] | None = None,
        light: Light | None = None,
        lit_frames: int | None = None,
    ) -> Frame:
        """Render a frame.

        Parameters
        ----------
        frame_index : int
            Frame k spans the frame periods k to k + 1; its row r is read at k + r / line_periods_per_frame.
        out : numpy.ndarray, optional
            (rows, cols) uint8, C-contiguous; allocated if not given.
        line_rows : numpy.ndarray, optional
            (rows,) row of the confocal view on which the laser line lies in the middle of each camera row's exposure;
            NaN where the laser is off. None is the ideal scan, ``numpy.arange(rows)``; a standing line is a constant.
        light : numpy.ndarray, optional
            From :meth:`core_light`, for a frame at the same place; computed if not given.
        lit_frames : int, optional
            Number of frames for which the specimen was lit, and bleached, before; `frame_index` if not given.

        Returns
        -------
        numpy.ndarray
            ``out``.

        Raises
        ------
        InputError
            If the probe leaves a finite scene, or an array has the wrong shape.
        """
        if out is None:
            out = np.empty(self.frame_shape, np.uint8)
        elif out.shape != self.frame_shape or out.dtype != np.uint8:
            raise InputError(f"a frame buffer {out.shape} {out.dtype}", f"give {self.frame_shape} uint8")
        core_dn = self.core_values(frame_index, line_rows=line_rows, light=light, lit_frames=lit_frames)
        camera = self.instrument
        readout = self._disturbances.readout(frame_index) if self._disturbances else UNDISTURBED
        left, right = (view.spots for view in self._views)
        expose(
            out, left, core_dn[0] * np.float32(left.scale), right, core_dn[1] * np.float32(right.scale),
            self._row_signal, *readout,
            camera.black_dn, camera.electrons_per_dn, camera.read_noise_e, _noise_key(self._seed, frame_index),
        )  # fmt: skip
        return out

    def core_values(
        self,
        frame_index: int,
        *,
        line_rows: NDArray[np.float64] | None = None,
        light: Light | None = None,
        lit_frames: int | None = None,
    ) -> Light:
        """Return the grey level of each core in confocal and residual view, before pixels, background and noise.

        Parameters
        ----------
        frame_index, line_rows, light, lit_frames
            As of :meth:`render`.

        Returns
        -------
        numpy.ndarray
            (2, cores) mean grey levels, cores in the order of ``instrument.bundle.cores()``; overwritten by the next
            call.
        """
        if light is None:
            light = self.core_light(frame_index, self._unfaded, line_rows=line_rows)
        fading = UNFADED
        if self._disturbances is not None:
            lit_frames = frame_index if lit_frames is None else lit_frames
            fading = self._disturbances.fading(lit_frames, self.row_positions_um(frame_index))
        for values, (total, of_bundle) in zip(self._values, light, strict=True):
            fade_cores(values, total, of_bundle, *fading)
        return self._values

    def core_light(self, frame_index: int, out: Light, *, line_rows: NDArray[np.float64] | None = None) -> Light:
        """Compute the light on each core, in grey levels, before the specimen bleaches and the bundle bends.

        Parameters
        ----------
        frame_index, line_rows
            As of :meth:`render`.
        out : numpy.ndarray
            Output of shape ``light_shape``, (2, 2, cores), float32.

        Returns
        -------
        numpy.ndarray
            ``out``: for confocal and residual view the total, and the part that arises in the bundle.
        """
        mixed = self._light.at(line_rows, self._disturbances.jitter_rows(frame_index) if self._disturbances else 0.0)
        positions_um = self.row_positions_um(frame_index)
        turns = self.row_turns(frame_index)
        self._refuse_outside(frame_index, positions_um)
        self._cover(positions_um, mixed.shifts_um)
        views = zip(self._views, mixed.first.views, mixed.second.views, out, strict=True)
        for view, first, second, (total, of_bundle) in views:
            sample_cores(
                total, of_bundle, first, second, mixed.share,
                view.rows_px, self._cores.rows_um, self._cores.cols_um, positions_um,
                np.empty((0, 2)) if turns is None else turns,
                self._samples, self._first, self._sizes, self._per_um,
            )  # fmt: skip
        return out

    def row_positions_um(self, frame_index: int) -> NDArray[np.float64]:
        """Return the position of the probe, (rows, 2) um, when each camera row of a frame (by its index) is read."""
        return np.ascontiguousarray(self.trajectory.positions_um(self._row_times_s(frame_index)))

    def row_turns(self, frame_index: int) -> NDArray[np.float64] | None:
        """Return cosine and sine of the probe's angle, (rows, 2), by a frame's index; None if it does not rotate."""
        if not isinstance(self.trajectory, TurningTrajectory):
            return None
        angle = self.trajectory.angles_rad(self._row_times_s(frame_index))
        return np.stack([np.cos(angle), np.sin(angle)], axis=1)

    def _row_times_s(self, frame_index: int) -> NDArray[np.float64]:
        optics = self.instrument.optics
        periods = frame_index + np.arange(self.frame_shape[0]) / optics.line_periods_per_frame
        return np.asarray(periods * optics.frame_period_s, np.float64)

    def in_focus(self) -> Renderer:
        """Return a renderer of the same views without out-of-focus light, background and noise.

        Its confocal view is the result of perfect sectioning, times the fraction of the signal that is kept.
        """
        geometry = self.instrument.imperfections.of_left_geometry
        bare = replace(self.instrument, autofluorescence=0.0, black_dn=0.0, imperfections=geometry)
        return Renderer(bare, self.scene.in_focus(), self.trajectory, noise=False)

    def refuse_path(self, frames: int) -> None:
        """Raise if the probe leaves the scene within a number of frames.

        Raises
        ------
        InputError
            Naming the first frame that reaches beyond a finite scene, or lies outside a recorded path.
        """
        for frame_index in range(frames):
            self._refuse_outside(frame_index, self.row_positions_um(frame_index))

    def _cover(self, positions_um: NDArray[np.float64], shifts_um: Iterable[tuple[float, float]]) -> None:
        radius = self.instrument.bundle.radius_um
        low, high = positions_um.min(0) - radius, positions_um.max(0) + radius
        for layer, (up_um, down_um) in zip(self._layers, shifts_um, strict=True):
            layer.cover(low[0] + up_um, low[1], high[0] + down_um, high[1])

    def _refuse_outside(self, frame_index: int, positions_um: NDArray[np.float64]) -> None:
        bounds = self.scene.bounds_um
        if bounds is None:
            return
        radius = self.instrument.bundle.radius_um
        low, high = positions_um.min(0) - radius, positions_um.max(0) + radius
        beyond = max(bounds[0] - low[0], bounds[1] - low[1], high[0] - bounds[2], high[1] - bounds[3])
        if beyond > 0:
            tall, wide = bounds[2] - bounds[0], bounds[3] - bounds[1]
            raise InputError(
                f"frame {frame_index} is {beyond:.0f} um beyond the edge of the scene of {tall:.0f} x {wide:.0f} um",
                "give a larger scene or a shorter path",
            )


def _noise_key(seed: int, frame_index: int) -> int:
    return int(np.random.SeedSequence((seed, frame_index)).generate_state(1, np.uint64)[0] >> np.uint64(1))
