"""Light on each core of each view, from the position of the laser line while the core's row is exposed.

A Gaussian line times a Gaussian collection is a Gaussian: for each plane, the core and the halo of the line give one
blurred image each, sampled at a shifted row and scaled. Slit offset, line tilt, a wrong ramp and a line that flies back
change shift and scale only, so that an ideal and a faulty scan cost the same. Shifts and scales are kept while the line
positions do not change.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from napari_elsplus.simulation.model.axial_response import gaussian_over_slit, line_response
from napari_elsplus.simulation.model.illumination import edge
from napari_elsplus.simulation.model.instrument import REFERENCE_SLIT_ROWS
from napari_elsplus.simulation.specimen.layers import Blur
from napari_elsplus.simulation.specimen.textures import Uniform

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.simulation.model.bundle import Cores
    from napari_elsplus.simulation.model.instrument import Instrument
    from napari_elsplus.simulation.rendering.views import BundleView
    from napari_elsplus.simulation.specimen.scenes import Plane, Scene

_FAR_UM = 1e6
"""Lag, rows, that stands for a laser that is off: the line is beyond any bundle."""
_NEGLIGIBLE = 1e-5
"""Fraction of the in-focus light below which no row shift is computed."""
_ALIKE = 0.25
"""Difference of two blurs, in standard deviations, below which they are rendered as one: deep planes; chosen."""


@dataclass(frozen=True, slots=True)
class Term:
    """One blurred image that contributes to every core: a textured plane through parts of the line."""

    plane: Plane
    parts: tuple[int, ...]
    """0: core of the line, 1: its halo; both, where they see the same."""
    blur: Blur


class CoreLight(NamedTuple):
    """Light on the cores of one view: a steady part, and for each term a scale and a row shift.

    ``steady`` (cores,), ``scale`` and ``shift_um`` (terms, cores): grey levels, and micrometres along the rows.
    """

    steady: NDArray[np.float32]
    scale: NDArray[np.float32]
    shift_um: NDArray[np.float32]


class _Product(NamedTuple):
    """A Gaussian's middle, per offset of the line, and its standard deviation."""

    pull: float
    sigma_um: float


class Scan:
    """Computes the light on the cores from line positions.

    Parameters
    ----------
    instrument : Instrument
        The optics.
    scene : Scene
        The specimen.
    cores : Cores
        The bundle's cores.
    """

    def __init__(self, instrument: Instrument, scene: Scene, cores: Cores) -> None:
        self._instrument, self._scene, self._cores = instrument, scene, cores
        self._edge = edge(instrument.bundle.radius_um, instrument.line, instrument.slit_um)
        self._smear_um = instrument.slit_um / np.sqrt(12)
        self._place_on_grid()
        self.terms = tuple(term for plane in scene.planes for term in self._terms_of(plane))

    def light(self, view: BundleView, line_rows: NDArray[np.float64] | None) -> CoreLight:
        """Return the light on the cores of a view.

        Parameters
        ----------
        view : BundleView
            The view.
        line_rows : numpy.ndarray or None
            (rows,) line positions; see :meth:`Renderer.render`.
        """
        instrument = self._instrument
        cores = len(self._cores.rows_um)
        steady = np.zeros(cores)
        scale, shift_um = np.zeros((2, len(self.terms), cores), np.float32)
        strength = (
            instrument.light_dn * instrument.slit_rows / REFERENCE_SLIT_ROWS * view.gain * self._cores.transmission
        )
        if self._scene.transmission:
            for plane in self._scene.planes:
                if isinstance(plane.texture, Uniform):
                    steady += plane.brightness * strength
            for t, term in enumerate(self.terms):
                scale[t] = term.plane.brightness * strength
            return CoreLight(steady.astype(np.float32), scale, shift_um)

        offset_um, smear_um, grid_offset_um = self._offsets(view, line_rows)
        cache: dict[float, NDArray[np.float64]] = {}

        def parts(depth_um: float) -> NDArray[np.float64]:
            if depth_um not in cache:
                cache[depth_um] = strength * self._parts(depth_um, offset_um, smear_um, grid_offset_um)
            return cache[depth_um]

        steady += instrument.autofluorescence * parts(0.0).sum(0)
        for plane in self._scene.planes:
            if isinstance(plane.texture, Uniform):
                steady += plane.brightness * parts(plane.depth_um).sum(0)
        for t, term in enumerate(self.terms):
            received = parts(term.plane.depth_um)[list(term.parts)]
            total = received.sum(0)
            scale[t] = term.plane.brightness * total
            pulls = [self._product(part, term.plane.depth_um).pull for part in term.parts]
            lit = total > _NEGLIGIBLE * instrument.light_dn
            shift_um[t] = np.where(lit, offset_um * (pulls @ received) / np.where(lit, total, 1), 0)
        return CoreLight(steady.astype(np.float32), scale, shift_um)

    def _terms_of(self, plane: Plane) -> list[Term]:
        if isinstance(plane.texture, Uniform):
            return []
        mode_um = self._instrument.bundle.core_sigma * self._instrument.bundle.core_pitch_um
        if plane.depth_um == 0 or self._scene.transmission:
            return [Term(plane, (0, 1), Blur(mode_um, mode_um))]
        across = float(np.hypot(self._instrument.line.spread * plane.depth_um / np.sqrt(2), mode_um))
        core, halo = (self._product(part, plane.depth_um) for part in (0, 1))
        apart_um = abs(core.pull - halo.pull) * abs(self._instrument.offset_um)
        if apart_um < _ALIKE * core.sigma_um and abs(halo.sigma_um - core.sigma_um) < _ALIKE * core.sigma_um:
            blur = Blur(float(np.hypot((core.sigma_um + halo.sigma_um) / 2, mode_um)), across)
            return [Term(plane, (0, 1), blur)]
        return [
            Term(plane, (part,), Blur(float(np.hypot(product.sigma_um, mode_um)), across))
            for part, product in enumerate((core, halo))
        ]

    def _product(self, part: int, depth_um: float) -> _Product:
        """Spread line times collection, both Gaussians."""
        _, sigma_um = self._instrument.line.parts[part]
        collected = (self._instrument.line.spread * depth_um) ** 2 / 2
        excited = sigma_um**2 + self._smear_um**2 + collected
        pull = collected / (collected + excited)
        return _Product(pull, float(np.sqrt(pull * excited)))

    def _parts(
        self,
        depth_um: float,
        offset_um: NDArray[np.float64],
        smear_um: NDArray[np.float64],
        grid_offset_um: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """Return the light of a uniform plane of brightness 1 by core and halo of the line, (2, cores)."""
        line, optics = self._instrument.line, self._instrument.optics
        reference = float(line_response(0.0, 0.0, optics.um(REFERENCE_SLIT_ROWS), line))
        vignette = self._edge.vignette(grid_offset_um, depth_um).reshape(2, -1)
        received = np.empty((2, len(offset_um)))
        for part, (share, sigma_um) in enumerate(line.parts):
            width_um = np.hypot(sigma_um, line.spread * depth_um)
            unclipped = gaussian_over_slit(offset_um, smear_um, width_um) * (share / reference)
            received[part] = unclipped * (vignette[part][self._grid_index] * self._grid_weight).sum(0)
        return received

    def _offsets(
        self, view: BundleView, line_rows: NDArray[np.float64] | None
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Line minus core (um) and smear over the exposure (um) for each core; line minus core on the grid's rows."""
        instrument = self._instrument
        um, left_row = instrument.optics.um_per_px, instrument.confocal_centre[0]
        rows = np.arange(instrument.frame_shape[0], dtype=np.float64)
        lag = np.zeros_like(rows) if line_rows is None else line_rows - rows
        speed = np.ones_like(rows) if line_rows is None else np.abs(np.gradient(line_rows))
        lag = np.where(np.isfinite(lag), lag, _FAR_UM)
        speed = np.where(np.isfinite(speed), speed, 1.0)

        def off(camera_rows: NDArray[np.float64], bundle_rows_um: NDArray[np.float64]) -> NDArray[np.float64]:
            return np.asarray((camera_rows + np.interp(camera_rows, rows, lag) - left_row) * um - bundle_rows_um)

        grid = self._edge.grid_um
        tilt_um = np.tan(np.deg2rad(instrument.line_tilt_deg)) * self._cores.cols_um
        return (
            off(view.rows_px, self._cores.rows_um) + tilt_um,
            instrument.slit_um * np.interp(view.rows_px, rows, speed),
            off(view.centre_row + grid / um, grid),
        )

    def _place_on_grid(self) -> None:
        """Bilinear places of the cores on the vignette's grid."""
        grid = self._edge.grid_um
        points, step = len(grid), grid[1] - grid[0]
        y, x = ((axis - grid[0]) / step for axis in (self._cores.rows_um, self._cores.cols_um))
        i, j = (np.clip(axis.astype(np.intp), 0, points - 2) for axis in (y, x))
        fy, fx = y - i, x - j
        self._grid_index = np.stack([i, i, i + 1, i + 1]) * points + np.stack([j, j + 1, j, j + 1])
        self._grid_weight = np.stack([(1 - fy) * (1 - fx), (1 - fy) * fx, fy * (1 - fx), fy * fx])
