"""Brute-force rig that shares nothing with :mod:`napari_elsplus`: every camera row at its own time, light on a grid.

It is disturbed by what a calibration has to find or to survive, so that a clean and a rough rig of one seed are twins.
The line stands in the confocal view at the row that is read; a core at bundle row y is excited by the line averaged
over the slit. Light of a plane at depth z is excited through the line's chord on the bundle and collected by the
pixel's point, each spread by a Gaussian of k z / sqrt 2. Points of the bundle count from its centre, in pixels.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final

import cv2
import numpy as np
import tifffile
from scipy import sparse
from scipy.spatial import cKDTree
from scipy.special import erf

from benchmarks.rigs.row_scene import Scene

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

SPREAD: Final = 0.236
"""Standard deviation of the two-way spread over depth: the line-scan response of the paper's figure."""
HALO_UM: Final = 35.0
"""Standard deviation of the line's halo."""
STEP: Final = 4
"""Pixels between the points of an out-of-focus plane; chosen: below half of its spread."""
ROUGH: Final[Mapping[str, float]] = {
    "bow": 2.2,
    "right_distortion": 0.0022,
    "hot": 5e-4,
    "row_noise": 1.0,
    "flicker": 0.03,
    "uneven": 0.2,
    "ripple": 0.04,
}
"""Disturbances of a rough rig."""
_STATED: Final = ("left", "right", "tilt", "gain", "volt_per_row", "volt_0", "frames")
"""What ``truth.json`` repeats of a rig."""


@dataclass(frozen=True)
class RowRig:
    """Geometry, light, disturbances, scene and motion of one rig; disturbances are 0 on a clean one.

    Parameters
    ----------
    shape : tuple of int
        Rows and columns of a frame.
    left, right : tuple of float
        Centre (row, col) of the bundle in the confocal and the residual view.
    diameter, bundle_um, pitch_um : float
        Circle of core centres in px and um, and the cores' mean spacing.
    right_turn, right_scale, gain : float
        Rotation in degrees, scale and brightness of the residual view.
    tilt, line_um, halo, slit_rows : float
        Slope of the line in rows per column, its standard deviation, the share of its light in the halo, the slit.
    volt_per_row, volt_0 : float
        Galvo map.
    sweep_frames, sweep_range : int, tuple of float
        Standing lines, and the rows they span about the centre, in diameters.
    scene, motion, step, turn_deg, frames : str, str, float, float, int
        As in :class:`Scene`.
    idle_rows : float
        Line periods between the last row of a frame and the first of the next.
    signal, haze, depths_um : float, float, tuple of float
        Grey levels of a full-brightness core, out-of-focus light over that, and the planes it comes from.
    lamp, line_level, electrons, read, black, bits : float
        Grey levels of the lit bundle and of the standing line, electrons per grey level, read noise, level of darkness.
    bow : float
        Rows by which the line's ends lie below its middle.
    left_distortion, right_distortion : float
        Radial, as a fraction of the radius at the rim; positive: pincushion.
    hot, row_noise, flicker, row_flicker, uneven, ripple, prnu : float
        Share of hot pixels; grey levels; fractions of the light by frame, by row, along the line (slope and curve, and
        a sine), and of a pixel's gain.
    seed : int
        Of bundle, scene and noise.
    """

    shape: tuple[int, int] = (300, 600)
    left: tuple[float, float] = (149.0, 148.0)
    right: tuple[float, float] = (139.0, 451.5)
    diameter: float = 270.0
    bundle_um: float = 620.0
    pitch_um: float = 3.2
    right_turn: float = 0.0
    right_scale: float = 1.0
    gain: float = 1.0
    tilt: float = 0.004
    line_um: float = 3.0
    halo: float = 0.0
    slit_rows: float = 3.0
    volt_per_row: float = 0.00126
    volt_0: float = -0.459
    sweep_frames: int = 400
    sweep_range: tuple[float, float] = (-0.65, 0.65)
    scene: str = "fibres"
    motion: str = "smooth"
    step: float = 40.0
    turn_deg: float = 0.0
    idle_rows: float = 0.0
    frames: int = 90
    signal: float = 110.0
    haze: float = 0.6
    depths_um: tuple[float, ...] = (250.0, 450.0)
    lamp: float = 90.0
    line_level: float = 90.0
    electrons: float = 10.0
    read: float = 0.7
    black: float = 4.0
    bits: int = 8
    bow: float = 0.0
    left_distortion: float = 0.0
    right_distortion: float = 0.0
    hot: float = 0.0
    row_noise: float = 0.0
    flicker: float = 0.0
    row_flicker: float = 0.0
    uneven: float = 0.0
    ripple: float = 0.0
    prnu: float = 0.0
    seed: int = 0

    @property
    def um(self) -> float:
        """Micrometres per pixel."""
        return self.bundle_um / self.diameter

    @property
    def line_periods_per_frame(self) -> float:
        """Line periods from a frame to the next."""
        return self.shape[0] + self.idle_rows

    @property
    def radius(self) -> float:
        """Radius of the circle of core centres, px."""
        return self.diameter / 2

    @property
    def right_to_bundle(self) -> Floats:
        """Matrix from offsets in the residual image to offsets on the bundle, (2, 2)."""
        a = np.deg2rad(self.right_turn)
        return np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]]) / self.right_scale

    def bundle_points(self, view: str) -> Floats:
        """Return the bundle point (row, col) of every pixel of the frame in the "left" or "right" view."""
        q = np.moveaxis(np.mgrid[: self.shape[0], : self.shape[1]].astype(float), 0, -1) - getattr(self, view)
        q = q * (1 - getattr(self, f"{view}_distortion") * np.square(q).sum(-1, keepdims=True) / self.radius**2)
        return np.asarray(q if view == "left" else q @ self.right_to_bundle.T)

    def line_row(self, row: Floats | float, x: Floats) -> Floats:
        """Return the bundle row of a line at bundle column x that stands at a row of the confocal view."""
        return row - self.left[0] + self.tilt * x + self.bow * np.square(x / self.radius)

    def along(self, x: Floats) -> Floats:
        """Return the relative power of the line at bundle column x."""
        u = x / self.radius
        return 1 + self.uneven * (0.6 * u - 0.5 * u**2 + 0.15) + self.ripple * np.sin(2 * np.pi * 5.3 * u + self.seed)

    def profile(self, v: Floats, slit: float, x: Floats, line: Floats) -> Floats:
        """Return the line v rows off its middle, over its peak, averaged over the slit.

        The halo arises inside of the bundle, where the line at rows `line` and columns `x` meets it.
        """
        core, halo = self.line_um / self.um, HALO_UM / self.um
        chord = np.sqrt(np.clip(self.radius**2 - x**2, 0, None))
        lit = 0.5 * (1 + erf((chord - np.abs(line)) / (core * np.sqrt(2))))

        def mean(sigma: float) -> Floats:
            return np.asarray(erf((v + slit / 2) / (sigma * np.sqrt(2))) - erf((v - slit / 2) / (sigma * np.sqrt(2))))

        total = (1 - self.halo) * mean(core) + self.halo * lit * mean(halo)
        return np.asarray(total / (2 * erf(slit / 2 / (core * np.sqrt(2)))))


@dataclass(frozen=True)
class _Plane:
    """Weights of an out-of-focus plane: camera row, point (row, col) and its cell, both views' weights, collection."""

    row: NDArray[np.intp]
    at: tuple[Floats, Floats]
    cell: NDArray[np.intp]
    weights: dict[str, Floats]
    collected: dict[str, Floats]


class RowRecording:
    """Raw frames of one rig: of a scene, of a standing line, of the lit bundle, with their truth."""

    def __init__(self, rig: RowRig) -> None:
        self.rig = rig
        random = np.random.default_rng([rig.seed, 1])
        self.cores, self.through = self._bundle(random)
        self.hot = np.where(random.random(rig.shape) < rig.hot, random.uniform(15, 220, rig.shape), 0)
        self.response = 1 + rig.prnu * random.normal(size=rig.shape)
        self.noise = np.random.default_rng([rig.seed, 2])
        self.views = {view: self._spots(view) for view in ("left", "right")}

    @cached_property
    def scene(self) -> Scene:
        """The scene and the probe's path over it."""
        rig = self.rig
        random = np.random.default_rng([rig.seed, 3])
        return Scene(rig.scene, rig.motion, rig.step, rig.turn_deg, len(rig.depths_um), random)

    def _bundle(self, random: np.random.Generator) -> tuple[Floats, Floats]:
        """Return places (cores, 2) and transmission of irregular cores."""
        radius, pitch = self.rig.radius, self.rig.pitch_um / self.rig.um
        n = int(2 * radius / pitch) + 4
        j, i = np.mgrid[-n : n + 1, -n : n + 1]
        cores = np.stack((0.866 * pitch * j, pitch * (i + 0.5 * (j % 2))), -1).reshape(-1, 2)
        a = random.uniform(0, np.pi)
        cores = cores @ np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]])
        cores += random.normal(0, 0.13 * pitch, cores.shape)
        cores = cores[np.hypot(*cores.T) < radius]
        return cores, np.clip(random.normal(1, 0.15, len(cores)), 0.3, None)

    def _spots(self, view: str) -> sparse.csr_matrix:
        """Return each core's light in each pixel of a view, (pixels, cores); 1 in the mean of a lit bundle."""
        rig, q = self.rig, self.rig.bundle_points(view).reshape(-1, 2)
        pitch = rig.pitch_um / rig.um
        spot = 0.38 * pitch
        pixels = np.flatnonzero(np.hypot(*q.T) < rig.radius + 4 * spot)
        pixels = pixels[(pixels % rig.shape[1] < rig.shape[1] / 2) == (view == "left")]
        near = cKDTree(self.cores).query_ball_point(q[pixels], 3.2 * spot)
        pixel = np.repeat(pixels, [len(cores) for cores in near])
        core = np.concatenate([np.array(cores, int) for cores in near])
        d = q[pixel] - self.cores[core]
        parts = [(a, b) for a in (-1 / 3, 0, 1 / 3) for b in (-1 / 3, 0, 1 / 3)]  # of the pixel's area
        light = np.mean([np.exp(-((d[:, 0] + a) ** 2 + (d[:, 1] + b) ** 2) / (2 * spot**2)) for a, b in parts], axis=0)
        light *= 0.866 * pitch**2 / (2 * np.pi * spot**2) * self.through[core] * (rig.gain if view == "right" else 1)
        return sparse.csr_matrix((light, (pixel, core)), (len(q), len(self.cores)))

    @cached_property
    def _focus(self) -> dict[str, tuple[NDArray[np.intp], NDArray[np.intp], sparse.csr_matrix]]:
        """Camera row and core of each lit pair in each view, and the matrix from pairs to pixels."""
        rig, found = self.rig, {}
        for view, spots in self.views.items():
            spot = spots.tocoo()
            row = spot.row // rig.shape[1]
            y, x = self.cores[spot.col].T
            line = rig.line_row(row, x)
            light = spot.data * rig.profile(y - line, rig.slit_rows, x, line) * rig.along(x)
            lit = light > 1e-5
            key, pair = np.unique(row[lit] * len(self.cores) + spot.col[lit], return_inverse=True)
            matrix = sparse.csr_matrix((light[lit], (spot.row[lit], pair)), (spots.shape[0], len(key)))
            found[view] = key // len(self.cores), key % len(self.cores), matrix
        return found

    @cached_property
    def _planes(self) -> list[_Plane]:
        return [self._plane(depth_um) for depth_um in self.rig.depths_um]

    def _plane(self, depth_um: float) -> _Plane:
        rig = self.rig
        spread = SPREAD * depth_um / np.sqrt(2) / rig.um
        count = int(np.ceil((rig.radius + 3 * spread) / STEP)) * 2 + 1
        coarse: Floats = STEP * np.arange(-(count - 1) / 2, count / 2, dtype=np.float64)
        fine: Floats = np.arange(-(STEP * count - 1) / 2, STEP * count / 2, dtype=np.float64)[:, None]
        core = rig.line_um / rig.um
        reach = 6 * core + 4 * HALO_UM / rig.um * (rig.halo > 0) + rig.slit_rows
        amount = rig.haze / len(rig.depths_um) * np.sqrt(1 + 2 * spread**2 / (core**2 + rig.slit_rows**2 / 12)) * STEP

        def gaussian(distance: NDArray[np.floating]) -> Floats:
            return np.asarray(np.exp(-np.square(distance) / (2 * spread**2)) / (spread * np.sqrt(2 * np.pi)))

        found: list[tuple[NDArray[Any], ...]] = []
        for row in range(rig.shape[0]):
            line = rig.line_row(row, fine.T)
            near = (fine > line.min() - reach) & (fine < line.max() + reach) & (np.abs(fine) < rig.radius)
            y, light = fine[near][:, None], np.zeros((len(fine), len(fine)))
            across = rig.profile(y - line, rig.slit_rows, fine.T, line) * rig.along(fine.T)
            light[near[:, 0]] = across * (np.hypot(y, fine.T) < rig.radius)
            light = cv2.resize(light, (count, count), interpolation=cv2.INTER_AREA)
            if light.max() < 1e-4:
                continue
            excited = amount * cv2.GaussianBlur(light, (0, 0), spread / STEP)
            weights = [excited * gaussian(coarse[:, None] - (row - at[0])) for at in (rig.left, rig.right)]
            at = np.nonzero(np.maximum(*weights) > 2e-5 * amount)
            found.append((np.full(len(at[0]), row), *at, *(weight[at] for weight in weights)))
        rows, y, x, left, right = (np.concatenate(part) for part in zip(*found, strict=True))
        collected = {
            view: STEP * gaussian(np.arange(rig.shape[1])[:, None] - getattr(rig, view)[1] - coarse)
            for view in ("left", "right")
        }
        return _Plane(rows, (coarse[y], coarse[x]), rows * count + x, {"left": left, "right": right}, collected)

    def focal(self, time: float, view: str) -> Floats:
        """Return the in-focus light of a scanned frame in one view, over full brightness."""
        row, core, matrix = self._focus[view]
        y, x = self.cores[core].T
        value = self.scene.focal(y, x, time + row / self.rig.line_periods_per_frame)
        return np.asarray(matrix @ value).reshape(self.rig.shape)

    def scanned(self, time: float) -> Floats:
        """Return the light of a scanned frame that begins at a time in frames, grey levels."""
        h, w = self.rig.shape
        periods = self.rig.line_periods_per_frame
        light = self.focal(time, "left") + self.focal(time, "right")
        flat = {view: np.asarray(spots.sum(axis=1)).reshape(h, w) for view, spots in self.views.items()}
        for number, plane in enumerate(self._planes):
            value = self.scene.deep(number, *plane.at, time + plane.row / periods)
            for view, collected in plane.collected.items():
                summed = np.bincount(plane.cell, value * plane.weights[view], h * collected.shape[1])
                light += flat[view] * (summed.reshape(h, -1) @ collected.T)
        return self.rig.signal * light

    def autofluorescence(self) -> Floats:
        """Return the bundle's own light in a scanned frame, grey levels."""
        total = sum(np.asarray(matrix.sum(axis=1)) for _, _, matrix in self._focus.values())
        return 0.006 * self.rig.signal * np.reshape(total, self.rig.shape)

    def standing(self, row: float) -> Floats:
        """Return the light of a line that stands at a row of the confocal view, grey levels."""
        y, x = self.cores.T
        line = self.rig.line_row(row, x)
        return self.rig.line_level * self._seen(self.rig.profile(y - line, 0.01, x, line) * self.rig.along(x))

    def lit(self) -> Floats:
        """Return the light of the bundle lit from its far end, grey levels."""
        return self.rig.lamp * self._seen(np.ones(len(self.cores)))

    def _seen(self, light: Floats) -> Floats:
        return np.reshape(sum(spots @ light for spots in self.views.values()), self.rig.shape)

    def expose(self, light: Floats) -> NDArray[np.unsignedinteger[Any]]:
        """Return a frame of the light, with the camera's and the laser's noise."""
        rig, random = self.rig, self.noise
        power = (1 + rig.flicker * random.normal()) * (1 + rig.row_flicker * random.normal(size=(rig.shape[0], 1)))
        value = random.poisson(np.clip(light * power * self.response, 0, None) * rig.electrons) / rig.electrons
        value = value + rig.black + rig.read * random.normal(size=rig.shape) + self.hot
        value += rig.row_noise * random.normal(size=(rig.shape[0], 1))
        grey = np.clip(np.round(value * 2 ** (rig.bits - 8)), 0, 2**rig.bits - 1)
        return np.asarray(grey, np.uint8 if rig.bits == 8 else np.uint16)

    def write(self, folder: Path) -> None:
        """Write recording, images for the calibration, in-focus views and truth into a folder.

        Parameters
        ----------
        folder : pathlib.Path
            Is made. ``still_infocus.tif`` is the rig's own focal plane, ``still_ideal.tif`` that under even light
            from a straight line; both without noise.
        """
        rig = self.rig
        folder.mkdir(parents=True, exist_ok=True)

        def save(name: str, frames: object) -> None:
            tifffile.imwrite(folder / f"{name}.tif", np.asarray(frames), compression="zlib", photometric="minisblack")

        first, last = (rig.left[0] + rig.diameter * end for end in rig.sweep_range)
        rows = np.linspace(first, last, rig.sweep_frames)
        volts = rig.volt_0 + rig.volt_per_row * rows
        np.savetxt(folder / "sweep_volts.csv", volts, header="volts", comments="")
        save("sweep", [self.expose(self.standing(row)) for row in rows])
        save("line", [self.expose(self.standing(rig.left[0] + 0.4)) for _ in range(5)])
        save("transmission", self.expose(self.lit()))
        dark = self.autofluorescence()
        save("background", [self.expose(dark) for _ in range(50)])
        times = np.arange(rig.frames + 1)
        if rig.frames:
            save("moving", [self.expose(dark + self.scanned(time)) for time in times[:-1]])
        truth = {
            **{name: getattr(rig, name) for name in _STATED},
            "diameter_px": rig.diameter,
            "offset_rows": rig.right[0] - rig.left[0],
            "right_to_bundle": rig.right_to_bundle.tolist(),
            "um_per_px": rig.um,
            "positions": self.scene.place(times).T.tolist(),
            "mid": self.scene.place(times[:-1] + rig.left[0] / rig.line_periods_per_frame).T.tolist(),
        }
        (folder / "truth.json").write_text(json.dumps(truth))
        np.save(folder / "scene.npy", self.scene.texture)
        self.scene.motion, self.scene.turn_deg = "still", 0.0
        still = self.scanned(0)
        save("still", [self.expose(dark + still) for _ in range(6)])
        ideal = RowRecording(replace(rig, motion="still", turn_deg=0.0, bow=0.0, uneven=0.0, ripple=0.0))
        for name, recording in (("infocus", self), ("ideal", ideal)):
            focal = np.round(rig.black + rig.signal * recording.focal(0, "left"))
            save(f"still_{name}", np.clip(focal, 0, 255).astype(np.uint8))
