"""The simulated rig that benchmarks look through: calibrated as a user would, with the truth known."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.processing.calibration.measurements import measure_flat_field
from napari_elsplus.processing.tracking.front_end.front_end import FrontEnd
from napari_elsplus.simulation.calibration_scenes import background, transmission
from napari_elsplus.simulation.model.instrument import REFERENCE_SLIT_ROWS, Instrument
from napari_elsplus.simulation.rendering.renderer import Renderer
from napari_elsplus.simulation.specimen.scenes import Plane, Scene, scene
from napari_elsplus.simulation.specimen.textures import Mottle
from napari_elsplus.simulation.truth import true_calibration

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.simulation.specimen.trajectories import Trajectory

    Image = NDArray[np.float32]

MIN_ELECTRONS_PER_DN_OF_FLAT: Final = 1.0


@dataclass(frozen=True)
class SimulatedRig:
    """An instrument, and the calibration with background and flat field that was measured on it."""

    instrument: Instrument
    calibration: Calibration

    @property
    def um_per_px(self) -> float:
        """Micrometres per camera pixel."""
        return self.instrument.optics.um_per_px

    def recording(
        self, looked_at: Scene, path: Trajectory | None, frames: int, *, seed: int = 0, noise: bool = True
    ) -> NDArray[np.uint8]:
        """Raw frames (T, rows, cols)."""
        renderer = Renderer(self.instrument, looked_at, path, seed=seed, noise=noise)
        return np.stack([renderer.render(k) for k in range(frames)])

    def periods_at_middle(self, frames: int) -> NDArray[np.float64]:
        """When the bundle's middle row is read in each frame, (T,), in frame periods."""
        line_periods_per_frame = self.instrument.optics.line_periods_per_frame
        return np.arange(frames, dtype=np.float64) + self.instrument.confocal_centre[0] / line_periods_per_frame

    def positions_px(self, path: Trajectory, frames: int) -> NDArray[np.float64]:
        """Return positions of the probe, camera pixels (T, 2), when the middle row of the bundle was read."""
        times_s = self.periods_at_middle(frames) * self.instrument.optics.frame_period_s
        return np.asarray(path.positions_um(times_s) / self.um_per_px, np.float64)

    def tracking_images(self, raw: Sequence[NDArray[np.uint8]] | NDArray[np.uint8]) -> list[Image]:
        """Images of the front end, one for each raw frame."""
        front_end = FrontEnd(self.calibration, self.instrument.frame_shape)
        side = front_end.grid.side
        return [front_end.image(frame, np.zeros((side, side), np.float32)) for frame in raw]


@cache
def simulated_rig(preset: str = "240hz", offset_um: float = -29.0, rate_hz: float | None = None) -> SimulatedRig:
    """Return a calibrated rig; the geometry is the true one, background and flat field are measured."""
    return measured(Instrument.of(preset, offset_um=offset_um, rate_hz=rate_hz))


def measured(instrument: Instrument) -> SimulatedRig:
    """Return the rig of an instrument, its background and flat field measured on it.

    The flat is lit so that it is not over-exposed by a wide slit, and brightly where the scene is dim.
    """
    known = true_calibration(instrument, background(instrument))
    lit = replace(
        instrument,
        light_dn=instrument.light_dn * min(1.0, REFERENCE_SLIT_ROWS / instrument.slit_rows),
        electrons_per_dn=max(instrument.electrons_per_dn, MIN_ELECTRONS_PER_DN_OF_FLAT),
    )
    flat = measure_flat_field(list(transmission(lit, seed=2)), known)
    return SimulatedRig(instrument, known.model_copy(update={"flat": flat}))


@cache
def dim(electrons_of_white: float) -> SimulatedRig:
    """Return a rig in dim light: so many electrons in a pixel that the camera shows as white, little read noise."""
    electrons_per_dn = electrons_of_white / Instrument.of("240hz").light_dn
    return measured(Instrument.of("240hz", electrons_per_dn=electrons_per_dn, read_noise_e=2.0))


def without_timing(calibration: Calibration) -> Calibration:
    """Return the calibration without rows per frame: frames are then taken as if all rows were read at once."""
    assert calibration.optics is not None
    return calibration.model_copy(
        update={"optics": calibration.optics.model_copy(update={"line_periods_per_frame": None})}
    )


@dataclass(frozen=True)
class StopAndGo:
    """The probe rests during each frame and jumps between frames: shifts without a rolling shutter."""

    positions: NDArray[np.float64]
    frame_period_s: float

    def positions_um(self, times_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Row and column at each time."""
        frame = np.floor(times_s / self.frame_period_s + 1e-6).astype(int)
        return np.asarray(self.positions[np.clip(frame, 0, len(self.positions) - 1)], np.float64)


def jumps(count: int, px: float, rig: SimulatedRig, binning: int, seed: int = 0) -> StopAndGo:
    """Pairs of resting places, that many tracking pixels apart in a random direction; pairs are far from each other."""
    random = np.random.default_rng(seed)
    angle = random.uniform(0, 2 * np.pi, count)
    step = px * binning * rig.um_per_px * np.column_stack([np.sin(angle), np.cos(angle)])
    start = random.uniform(-4000, 4000, (count, 2))
    places = np.stack([start, start + step], axis=1).reshape(-1, 2)
    return StopAndGo(places, rig.instrument.optics.frame_period_s)


def tissue(name: str, seed: int = 0) -> Scene:
    """Return a scene of the simulator by name, or `smooth`: soft mottle, in which there is hardly anything to see."""
    if name == "smooth":
        return Scene((Plane(Mottle(scale_um=120, seed=seed)),))
    return scene(name, seed)
