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

from napari_elsplus.simulation.model.axial_response import line_response
from napari_elsplus.simulation.model.bells import BELL, ERF
from napari_elsplus.simulation.model.illumination import vignetting
from napari_elsplus.simulation.model.instrument import REFERENCE_SLIT_ROWS
from napari_elsplus.simulation.rendering.reception import place_line, receive, weigh
from napari_elsplus.simulation.specimen.layers import Blur
from napari_elsplus.simulation.specimen.textures import Uniform

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.simulation.model.axial_response import LineModel
    from napari_elsplus.simulation.model.bundle import Cores
    from napari_elsplus.simulation.model.instrument import Instrument
    from napari_elsplus.simulation.rendering.views import BundleView
    from napari_elsplus.simulation.specimen.scenes import Plane, Scene

_FAR_ROWS = 1e6
"""Lag, rows, that stands for a laser that is off: the line is beyond any bundle."""
_NEGLIGIBLE = 1e-5
"""Fraction of the in-focus light below which no row shift is computed."""
_ALIKE = 0.25
"""Difference of two blurs, in standard deviations, below which they are rendered as one: deep planes; chosen."""
_VIGNETTE_STEPS_PER_ROW = 4
"""Jitters for which the vignetting is computed; derived: an eighth of a row changes no core at the rim by 0.2 % of the
brightest."""
_KEPT_VIGNETTES = 64
"""Most vignettes that are kept, of 74 kB; derived: of two views, a plane and the bundle's own light, with and without
cross-talk on the way back, at eight jitters."""


@dataclass(frozen=True, slots=True)
class Term:
    """One blurred image that contributes to every core: a textured plane through parts of the line."""

    plane: Plane
    parts: tuple[int, ...]
    """Indices of `LineScan.channels`; several, where they see the same."""
    blur: Blur


class CoreLight(NamedTuple):
    """Light on the cores of one view: a steady part, and for each term a scale and a row shift.

    ``of_bundle`` and ``steady`` (cores,), the former being the bundle's own share of the latter; ``scale`` and
    ``shift_um`` (terms, cores): grey levels, and micrometres along the rows.
    """

    of_bundle: NDArray[np.float32]
    steady: NDArray[np.float32]
    scale: NDArray[np.float32]
    shift_um: NDArray[np.float32]


class Channel(NamedTuple):
    """Share of the light that is excited by one part of the line and collected with one part of the cross-talk.

    ``part`` is 0 for the core of the line, 1 for its halo; ``collected_um`` is the standard deviation of the cross-talk
    on the way back, 0 for light that returns through the core it entered.
    """

    share: float
    part: int
    collected_um: float


def channels(line: LineModel, halo_in_collection: float) -> tuple[Channel, ...]:
    """Return the ways of the light through the bundle: excitation and collection, each with or without cross-talk.

    Light that suffers no cross-talk at all keeps its share; of the rest, a part arises on the way back.

    Parameters
    ----------
    line : LineModel
        The laser line; its halo is the cross-talk of the whole way.
    halo_in_collection : float
        Share of the cross-talk that arises on the way back, 0 to 1.
    """
    if not halo_in_collection:
        return tuple(Channel(share, part, 0.0) for part, (share, _) in enumerate(line.parts))
    alone = 1 - line.halo_share
    out, back = alone ** (1 - halo_in_collection), alone**halo_in_collection
    cross_talk_um = float(np.sqrt(line.halo_um**2 - line.core_um**2))
    return tuple(
        Channel(there * here, part, collected_um)
        for here, collected_um in ((back, 0.0), (1 - back, cross_talk_um))
        for part, there in enumerate((out, 1 - out))
    )


class _Product(NamedTuple):
    """A Gaussian's middle, per offset of the line, and its standard deviation."""

    pull: float
    sigma_um: float


class LineScan:
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
        self._edge = vignetting(instrument.bundle.radius_um, instrument.line, instrument.slit_um)
        self._smear_um = instrument.slit_um / np.sqrt(12)
        self.channels = channels(instrument.line, instrument.imperfections.halo_in_collection_percent / 100)
        self._along_line = _power_along_line(instrument, cores)
        bow_um = instrument.optics.um_per_px * instrument.imperfections.line_bow_rows
        tilt_um = np.tan(np.deg2rad(instrument.line_tilt_deg)) * cores.cols_um
        self._below_um = np.asarray(tilt_um + bow_um * (cores.cols_um / instrument.bundle.radius_um) ** 2, np.float64)
        self._place_on_grid()
        self._vignettes: dict[tuple[float, bytes], NDArray[np.float32]] = {}
        self.terms = tuple(term for plane in scene.planes for term in self._terms_of(plane))

    def light(self, view: BundleView, line_rows: NDArray[np.float64] | None, jitter_rows: float = 0.0) -> CoreLight:
        """Return the light on the cores of a view.

        Parameters
        ----------
        view : BundleView
            The view.
        line_rows : numpy.ndarray or None
            (rows,) line positions; see :meth:`Renderer.render`.
        jitter_rows : float
            Rows by which the whole line is lower. What the rim clips is computed for the nearest quarter of a row.
        """
        instrument = self._instrument
        cores = len(self._cores.rows_um)
        steady = np.zeros(cores)
        scale, shift_um = np.zeros((2, len(self.terms), cores), np.float32)
        strength = (
            instrument.light_dn * instrument.slit_rows / REFERENCE_SLIT_ROWS * view.gain * self._cores.transmission
        )
        if self._scene.transmission:
            strength = strength * view.lamp_factor
            for plane in self._scene.planes:
                if isinstance(plane.texture, Uniform):
                    steady += plane.brightness * strength
            for t, term in enumerate(self.terms):
                scale[t] = term.plane.brightness * strength
            return CoreLight(np.zeros(cores, np.float32), steady.astype(np.float32), scale, shift_um)

        if self._along_line is not None:
            strength = strength * self._along_line
        offset_um, smear_um, grid_offset_um = self._offsets(view, line_rows, jitter_rows)
        cache: dict[float, NDArray[np.float32]] = {}

        def parts(depth_um: float) -> NDArray[np.float32]:
            if depth_um not in cache:
                cache[depth_um] = self._parts(depth_um, strength, offset_um, smear_um, grid_offset_um)
            return cache[depth_um]

        steady += instrument.autofluorescence * parts(0.0).sum(0)
        of_bundle = steady.astype(np.float32)
        for plane in self._scene.planes:
            if isinstance(plane.texture, Uniform):
                steady += plane.brightness * parts(plane.depth_um).sum(0)
        for t, term in enumerate(self.terms):
            pulls = np.array([self._product(part, term.plane.depth_um).pull for part in term.parts])
            weigh(
                scale[t], shift_um[t], parts(term.plane.depth_um), np.array(term.parts), pulls,
                term.plane.brightness, offset_um, _NEGLIGIBLE * instrument.light_dn,
            )  # fmt: skip
        return CoreLight(of_bundle, steady.astype(np.float32), scale, shift_um)

    def _terms_of(self, plane: Plane) -> list[Term]:
        if isinstance(plane.texture, Uniform):
            return []
        mode_um = self._instrument.bundle.core_sigma * self._instrument.bundle.core_pitch_um
        if self._scene.transmission:
            return [Term(plane, (0, 1), Blur(mode_um, mode_um))]
        terms = []
        for first in range(0, len(self.channels), 2):
            pair, collected_um = (first, first + 1), self.channels[first].collected_um
            if plane.depth_um == collected_um == 0:
                terms.append(Term(plane, pair, Blur(mode_um, mode_um)))
                continue
            spread_um = self._instrument.line.spread * plane.depth_um / np.sqrt(2)
            across = float(np.hypot(np.hypot(spread_um, collected_um), mode_um))
            core, halo = (self._product(channel, plane.depth_um) for channel in pair)
            apart_um = abs(core.pull - halo.pull) * abs(self._instrument.offset_um)
            if apart_um < _ALIKE * core.sigma_um and abs(halo.sigma_um - core.sigma_um) < _ALIKE * core.sigma_um:
                blur = Blur(float(np.hypot((core.sigma_um + halo.sigma_um) / 2, mode_um)), across)
                terms.append(Term(plane, pair, blur))
                continue
            for channel, product in zip(pair, (core, halo), strict=True):
                terms.append(Term(plane, (channel,), Blur(float(np.hypot(product.sigma_um, mode_um)), across)))
        return terms

    def _product(self, index: int, depth_um: float) -> _Product:
        """Spread line times collection, both Gaussians."""
        _, part, collected_um = self.channels[index]
        _, sigma_um = self._instrument.line.parts[part]
        spread = (self._instrument.line.spread * depth_um) ** 2 / 2
        collected = spread + collected_um**2
        excited = sigma_um**2 + self._smear_um**2 + spread
        pull = collected / (collected + excited)
        return _Product(pull, float(np.sqrt(pull * excited)))

    def _parts(
        self,
        depth_um: float,
        strength: NDArray[np.float64],
        offset_um: NDArray[np.float64],
        smear_um: NDArray[np.float64],
        grid_offset_um: NDArray[np.float64],
    ) -> NDArray[np.float32]:
        """Return the light of a uniform plane of brightness 1 by each channel, (channels, cores)."""
        line, optics = self._instrument.line, self._instrument.optics
        reference = float(line_response(0.0, 0.0, optics.um(REFERENCE_SLIT_ROWS), line))
        received = np.empty((len(self.channels), len(offset_um)), np.float32)
        for index, (share, part, collected_um) in enumerate(self.channels):
            # Cross-talk on the way back spreads light over the face of the bundle as a greater depth would.
            as_deep_um = float(np.hypot(depth_um, collected_um / line.spread)) if collected_um else depth_um
            width_um = float(np.hypot(line.parts[part][1], line.spread * as_deep_um))
            receive(
                received[index], offset_um, smear_um, strength * (share / reference),
                self._vignette(grid_offset_um, as_deep_um)[part], *self._on_grid, width_um, BELL, ERF,
            )  # fmt: skip
        return received

    def _vignette(self, grid_offset_um: NDArray[np.float64], depth_um: float) -> NDArray[np.float32]:
        """Return the vignetting of core and halo, (2, points, points), kept while the line is where it was."""
        key = depth_um, grid_offset_um.tobytes()
        if key not in self._vignettes:
            if len(self._vignettes) >= _KEPT_VIGNETTES:
                self._vignettes.clear()
            self._vignettes[key] = self._edge.vignette(grid_offset_um, depth_um).astype(np.float32)
        return self._vignettes[key]

    def _offsets(
        self, view: BundleView, line_rows: NDArray[np.float64] | None, jitter_rows: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Line minus core (um) and smear over the exposure (um) for each core; line minus core on the grid's rows."""
        instrument = self._instrument
        um, left_row = instrument.optics.um_per_px, instrument.confocal_centre[0]
        rows = np.arange(instrument.frame_shape[0], dtype=np.float64)
        lag = np.zeros_like(rows) if line_rows is None else line_rows - rows
        speed = np.ones_like(rows) if line_rows is None else np.abs(np.gradient(line_rows))
        lag = np.where(np.isfinite(lag), lag, _FAR_ROWS)
        speed = np.where(np.isfinite(speed), speed, 1.0)
        offset_um, smear_um = np.empty((2, len(view.rows_px)))
        place_line(
            offset_um, smear_um, view.rows_px, self._cores.rows_um, self._below_um,
            lag + jitter_rows, speed, um, left_row, instrument.slit_um,
        )  # fmt: skip
        grid, near_rows = self._edge.grid_um, round(jitter_rows * _VIGNETTE_STEPS_PER_ROW) / _VIGNETTE_STEPS_PER_ROW
        grid_rows = view.centre_row + grid / um
        grid_offset_um = (grid_rows + np.interp(grid_rows, rows, lag) + near_rows - left_row) * um - grid
        return offset_um, smear_um, np.asarray(grid_offset_um, np.float64)

    def _place_on_grid(self) -> None:
        """Bilinear places of the cores on the vignette's grid."""
        grid = self._edge.grid_um
        points, step = len(grid), grid[1] - grid[0]
        y, x = ((axis - grid[0]) / step for axis in (self._cores.rows_um, self._cores.cols_um))
        i, j = (np.clip(axis.astype(np.int32), 0, points - 2) for axis in (y, x))
        self._on_grid = i * points + j, (y - i).astype(np.float32), (x - j).astype(np.float32)


def _power_along_line(instrument: Instrument, cores: Cores) -> NDArray[np.float64] | None:
    """Return the line's power at each core relative to that at its middle; None of an even line."""
    given = instrument.imperfections
    if not (given.line_fall_off_percent or given.line_slant_percent):
        return None
    place = cores.cols_um / instrument.bundle.radius_um
    fall_off = (1 - given.line_fall_off_percent / 100) ** (place**2)
    return np.asarray(fall_off * (1 + given.line_slant_percent / 100 * place))
