"""Rigs drawn at random, for calibrating against a truth that the estimators do not know.

A deliberately simple model that shares nothing with :mod:`napari_elsplus.simulation`: cores on a jittered lattice, each
a Gaussian spot, lit by a laser line with a halo or from the far end, seen twice, with photon and read noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Final, Self

import numpy as np
from scipy import sparse

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Frame = NDArray[np.uint8]

LASER_NOISE: Final = 0.003
"""Standard deviation of the light from one reading of the scan's signal to the next, as a fraction."""
_SLIT_ROWS: Final = 3
_SCANNED_FRAMES: Final = 4
"""Over which a reading of the scan's signal is averaged."""


@dataclass(frozen=True)
class Rig:
    """A bundle seen twice by one camera, and all that a calibration should find.

    Parameters
    ----------
    left, right : tuple of float
        Centres (row, col) of the two images.
    diameter_px : float
        Diameter of the circle of core centres in the left image.
    pitch_px : float
        Distance between neighbouring cores.
    line_rows, halo_rows, halo_share : float
        Standard deviations of the line and of its halo, and the halo's share of the light.
    tilt_deg : float
        Tilt of the line in the left image.
    turn_deg, scale, gain : float
        Rotation, magnification and brightness of the right view against the left.
    volts_per_row, volts_at_row_zero : float
        The galvo's map.
    photons : float
        Electrons of the brightest pixel of an evenly lit bundle.
    uneven : float
        Fall of the far-end light towards one side, as a fraction.
    electrons_per_dn, read_noise_e, black_dn : float
        The camera.
    lag_rows : float
        Rows by which the line is late at full speed.
    seed : int
        Of the cores and of the noise.
    """

    left: tuple[float, float]
    right: tuple[float, float]
    diameter_px: float
    pitch_px: float = 2.6
    line_rows: float = 2.0
    halo_rows: float = 20.0
    halo_share: float = 0.3
    tilt_deg: float = 0.0
    turn_deg: float = 0.0
    scale: float = 1.0
    gain: float = 1.0
    volts_per_row: float = 0.00126
    volts_at_row_zero: float = -0.459
    photons: float = 1000.0
    uneven: float = 0.0
    electrons_per_dn: float = 8.0
    read_noise_e: float = 4.0
    black_dn: float = 4.0
    lag_rows: float = 25.0
    seed: int = 0

    @classmethod
    def draw(cls, seed: int) -> Self:
        """Draw a rig: geometry, tilt to 2 degrees, offset of either sign, turn, scale, gain, light, all at random."""
        random = np.random.default_rng(seed)
        diameter = random.uniform(220, 320)
        offset = random.choice([-1, 1]) * random.uniform(4, 24)
        photons = 10 ** random.uniform(1.5, 3.3)
        return cls(
            left=(diameter / 2 + 30 + random.uniform(0, 4), diameter / 2 + random.uniform(8, 30)),
            right=(diameter / 2 + 30 + offset + random.uniform(0, 1), 1.5 * diameter + random.uniform(50, 75)),
            diameter_px=diameter,
            pitch_px=random.uniform(2.3, 3.6),
            line_rows=random.uniform(1.3, 4.5),
            halo_rows=random.uniform(12, 30),
            halo_share=random.uniform(0, 0.6),
            tilt_deg=random.uniform(-2, 2),
            turn_deg=random.choice([0.0, random.uniform(-0.5, 0.5)]),
            scale=random.choice([1.0, random.uniform(0.994, 1.006)]),
            gain=random.uniform(0.85, 1.15),
            volts_per_row=random.choice([-1, 1]) * random.uniform(0.8e-3, 2.5e-3),
            volts_at_row_zero=random.uniform(-0.6, 0.6),
            photons=photons,
            uneven=random.uniform(0, 0.4),
            electrons_per_dn=max(photons / 120, 0.5),
            read_noise_e=random.uniform(1, 4),
            black_dn=random.uniform(3, 9),
            seed=seed,
            lag_rows=random.uniform(3, 60),
        )

    def with_photons(self, photons: float) -> Self:
        """Return the same rig in other light, the camera's gain following."""
        return replace(self, photons=photons, electrons_per_dn=max(photons / 120, 0.5))

    def over_exposed(self, times: float) -> Self:
        """Return the same rig with the camera's gain raised so many times."""
        return replace(self, electrons_per_dn=self.electrons_per_dn / times)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of a frame."""
        rows = int(max(self.left[0], self.right[0]) + self.diameter_px / 2 + 12)
        return rows, int(self.right[1] + self.diameter_px / 2 + 14)

    @property
    def left_to_right(self) -> Floats:
        """Vector from the left centre to the vector from the right centre, (row, col), 2 x 2."""
        c, s = np.cos(np.radians(self.turn_deg)), np.sin(np.radians(self.turn_deg))
        return np.asarray(self.scale * np.array([[c, -s], [s, c]]), np.float64)

    @property
    def residual_to_confocal(self) -> Floats:
        """True result of :func:`napari_elsplus.processing.calibration.bundle.view_alignment.align_views`."""
        back = np.linalg.inv(self.left_to_right)
        return np.column_stack([back, np.array(self.left) - back @ np.array(self.right)])

    @cached_property
    def cores(self) -> Floats:
        """Core positions about the centre, (cores, 2)."""
        random = np.random.default_rng(self.seed)
        reach = int(self.diameter_px / self.pitch_px) + 4
        i, j = np.mgrid[-reach : reach + 1, -reach : reach + 1]
        lattice = np.stack([i * np.sqrt(3) / 2, j + 0.5 * (i % 2)], axis=-1).reshape(-1, 2) * self.pitch_px
        angle = random.uniform(0, np.pi / 3)
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        jittered = lattice @ turn + random.uniform(-0.5, 0.5, 2) * self.pitch_px
        jittered += random.normal(0, 0.07 * self.pitch_px, lattice.shape)
        inside: Floats = jittered[np.hypot(*jittered.T) < self.diameter_px / 2]
        return inside

    @cached_property
    def transmission(self) -> Floats:
        """Brightness of each core, mean 1."""
        random = np.random.default_rng(self.seed + 1)
        return np.asarray(np.clip(random.normal(1, 0.15, len(self.cores)), 0.3, None), np.float64)

    def line_row(self, row: float) -> float:
        """Row in the right image, at its centre's column, of a line at a row about the left centre."""
        slope = np.tan(np.radians(self.tilt_deg))
        (a, b), (c, d) = self.left_to_right
        x = -c * row / (c * slope + d)
        return float(self.right[0] + a * (row + slope * x) + b * x)

    def offset_rows(self, row: float) -> float:
        """Right minus left row of a line standing at a row about the left centre."""
        return self.line_row(row) - (self.left[0] + row)

    def lit_from_far_end(self, target: Floats | None = None) -> Floats:
        """Mean electrons of the bundle lit from the far end, with light per core if given."""
        x = self.cores[:, 1] / self.diameter_px
        light = 1 - self.uneven * (x + 0.5)
        return self._frame(light if target is None else light * target)

    def lit_by_line(self, row: float) -> Floats:
        """Mean electrons of a frame with the line standing at a row about the left centre."""
        away = self.cores[:, 0] - row - np.tan(np.radians(self.tilt_deg)) * self.cores[:, 1]
        line = np.exp(-(away**2) / (2 * self.line_rows**2))
        halo = np.exp(-(away**2) / (2 * self.halo_rows**2)) * self.line_rows / self.halo_rows
        return self._frame((1 - self.halo_share) * line + self.halo_share * halo)

    def line(self, count: int = 5, row: float = 1.3) -> Frame:
        """Frames of the line standing near the middle, (count, rows, cols)."""
        return self._noisy(np.repeat(self.lit_by_line(row)[None], count, axis=0), 2)

    def sweep(self, volts: Floats) -> Frame:
        """Return a frame per voltage, (volts, rows, cols)."""
        rows = (volts - self.volts_at_row_zero) / self.volts_per_row - self.left[0]
        return np.concatenate([self._noisy(self.lit_by_line(row)[None], 10 + k) for k, row in enumerate(rows)])

    def volts(self, count: int = 400) -> Floats:
        """Voltages that sweep the line over the bundle and past it, to 0.6 diameters from its centre."""
        rows = self.left[0] + np.linspace(-0.6, 0.6, count) * self.diameter_px
        return np.asarray(self.volts_at_row_zero + self.volts_per_row * rows, np.float64)

    def bundle(self, count: int = 1) -> Frame:
        """Frames of the bundle lit from the far end, (count, rows, cols)."""
        return self._noisy(np.repeat(self.lit_from_far_end()[None], count, axis=0), 3)

    def background(self, count: int = 50) -> Frame:
        """Frames of the dark tube, (count, rows, cols)."""
        return self._noisy(np.zeros((count, *self.shape)), 4)

    def scanned_signal(self, lead_rows: float) -> float:
        """Mean grey level of the left disc, the slit running over it and the line running ahead of it by a lead."""
        slit_rows, frames = _SLIT_ROWS, _SCANNED_FRAMES
        y, x = self.cores.T
        sigma = 0.33 * self.pitch_px
        row = np.arange(-4, 5)[:, None] + np.rint(y)
        light = np.zeros(len(y))
        for exposed in np.arange(slit_rows) - (slit_rows - 1) / 2:
            away = y - row - exposed - (lead_rows - self.lag_rows) - np.tan(np.radians(self.tilt_deg)) * x
            line = np.exp(-(away**2) / (2 * self.line_rows**2))
            halo = np.exp(-(away**2) / (2 * self.halo_rows**2)) * self.line_rows / self.halo_rows
            lit = (1 - self.halo_share) * line + self.halo_share * halo
            light += (lit * np.exp(-((row - y) ** 2) / (2 * sigma**2))).sum(axis=0) / slit_rows
        electrons = frames * self.photons * np.sqrt(2 * np.pi) * sigma * float(light @ self.transmission)
        random = np.random.default_rng((self.seed, 5, round(1000 * (lead_rows + 100))))
        pixels = np.pi * (self.diameter_px / 2) ** 2
        seen = random.poisson(electrons) + random.normal(0, self.read_noise_e * np.sqrt(frames * pixels))
        return float(seen * random.normal(1, LASER_NOISE) / (frames * pixels * self.electrons_per_dn) + self.black_dn)

    @cached_property
    def _spots(self) -> sparse.csr_matrix:
        """Light of each core on each pixel, both views: (pixels, cores)."""
        rows, cols = self.shape
        reach = int(np.ceil(3.2 * 0.33 * self.pitch_px))
        offsets = np.moveaxis(np.mgrid[-reach : reach + 1, -reach : reach + 1], 0, -1).reshape(-1, 2)
        total = None
        for centre, turn, gain in (
            (self.left, np.eye(2), 1.0),
            (self.right, self.left_to_right, self.gain),
        ):
            at = self.cores @ turn.T + np.array(centre)
            sigma = 0.33 * self.pitch_px * np.sqrt(np.linalg.det(turn))
            pixel = np.rint(at).astype(int)[:, None] + offsets
            away = np.square(pixel - at[:, None]).sum(axis=2)
            light = gain * np.exp(-away / (2 * sigma**2)) * self.transmission[:, None]
            seen = ((pixel >= 0) & (pixel < (rows, cols))).all(axis=2)
            number = pixel[..., 0] * cols + pixel[..., 1]
            core = np.broadcast_to(np.arange(len(at))[:, None], seen.shape)
            view = sparse.csr_matrix((light[seen], (number[seen], core[seen])), shape=(rows * cols, len(at)))
            total = view if total is None else total + view
        return total

    def _frame(self, light: Floats) -> Floats:
        return np.asarray(self.photons * (self._spots @ light), np.float64).reshape(self.shape)

    def _noisy(self, electrons: Floats, stream: int) -> Frame:
        random = np.random.default_rng((self.seed, stream))
        noisy = random.poisson(electrons) + random.normal(0, self.read_noise_e, electrons.shape)
        return np.clip(np.rint(noisy / self.electrons_per_dn + self.black_dn), 0, 255).astype(np.uint8)
