"""Recordings with exact truth: a texture sampled through a fixed core pattern, every row at its own time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np
from scipy import sparse, spatial

from napari_elsplus.instrument.calibration import Calibration
from napari_elsplus.processing.calibration.measurements import measure_flat_field

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True)
class Truth:
    frames: NDArray[np.uint8]
    calibration: Calibration
    positions: NDArray[np.float64]
    """Probe positions (row, col) at the time at which the bundle's middle row is read, px."""
    starts: NDArray[np.float64]
    """Positions at the start of each frame, and at the end of the last."""
    scene: NDArray[np.float32]


def fibres(
    side: int,
    count: int,
    seed: int,
    *,
    width_px: float = 2.0,
    half_length_px: tuple[float, float] = (100.0, 500.0),
    grain: float = 0.0,
) -> NDArray[np.float32]:
    """Draw `count` straight bright fibres in all directions on black, 0 to 1; `grain` varies them along themselves."""
    rng = np.random.default_rng(seed)
    image = np.zeros((side, side), np.float32)
    for _ in range(count):
        centre, angle, half = rng.uniform(0, side, 2), rng.uniform(0, np.pi), rng.uniform(*half_length_px)
        along = half * np.array([np.cos(angle), np.sin(angle)])
        ends = [tuple(int(v) for v in 16 * (centre + sign * along)) for sign in (-1, 1)]
        cv2.line(image, ends[0], ends[1], float(rng.uniform(0.4, 1.0)), 3, cv2.LINE_AA, 4)
    return cv2.GaussianBlur(image * (1 + grain * (2 * texture(side, seed + 500, 3.0) - 1)), (0, 0), width_px)


def texture(side: int, seed: int, grain_px: float = 4.0) -> NDArray[np.float32]:
    """Random texture like stained tissue, 0 to 1."""
    noise = np.random.default_rng(seed).normal(size=(side, side)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), grain_px)
    return np.clip(0.5 + 0.25 * smooth / smooth.std(), 0, 1)


def record(
    scene: NDArray[np.float32],
    starts: NDArray[np.float64],
    *,
    diameter: float = 210.0,
    shape: tuple[int, int] = (236, 480),
    left: tuple[float, float] = (117.3, 116.6),
    right: tuple[float, float] = (109.1, 355.2),
    line_periods_per_frame: float = 250.0,
    photons: float = 900.0,
    haze: float = 0.5,
    haze_left_over: float = 0.06,
    gain: float = 1.0,
    turn_deg: float = 0.0,
    seed: int = 0,
) -> Truth:
    """Frames of a probe that is at ``starts[k]`` (row, col) as frame k starts and moves evenly to the next start."""
    rng = np.random.default_rng(seed)
    pitch = 1.4
    rows, cols = np.mgrid[-diameter / 2 : diameter / 2 : pitch * 0.866, -diameter / 2 : diameter / 2 : pitch]
    cols = cols + pitch / 2 * (np.arange(len(cols)) % 2)[:, None]
    cores = np.stack([rows.ravel(), cols.ravel()], 1) + rng.normal(0, 0.12, (rows.size, 2))
    cores = cores[np.hypot(*cores.T) < diameter / 2]
    transmission = np.clip(rng.normal(1, 0.15, len(cores)), 0.4, 1.6)
    turn = np.deg2rad(turn_deg)
    rotation = np.array([(np.cos(turn), -np.sin(turn)), (np.sin(turn), np.cos(turn))])
    places = [cores + left, cores @ rotation.T + right]
    spread = [_spread(place, shape) for place in places]
    defocused = cv2.GaussianBlur(texture(len(scene), seed + 1000, 12.0), (0, 0), 10.0)
    frames = np.empty((len(starts) - 1, *shape), np.uint8)
    for k in range(len(frames)):
        mean = np.full(shape[0] * shape[1], 4.0)
        for place, matrix, in_focus, brightness in zip(places, spread, (1.0, 0.0), (1.0, gain), strict=True):
            moved = starts[k] + (place[:, :1] / line_periods_per_frame) * (starts[k + 1] - starts[k])
            at = (cores + moved).astype(np.float32)
            kept = 1.0 if in_focus else 1.0 - haze_left_over
            light = haze * kept * _sample(defocused, at) + in_focus * _sample(scene, at)
            mean += matrix @ (150 * brightness * transmission * light)
        noisy = rng.poisson(mean * photons / 150) * (150 / photons)
        frames[k] = np.clip(np.round(noisy + rng.normal(0, 0.3, noisy.shape)), 0, 255).reshape(shape)
    middle = left[0] / line_periods_per_frame
    to_confocal = np.column_stack([rotation.T, np.array(left) - rotation.T @ right])
    content = {
        "bundle": {
            "confocal_centre": left,
            "residual_centre": right,
            "diameter_px": diameter + 2,
            "residual_to_confocal": to_confocal.tolist(),
            "residual_gain": gain,
        },
        "optics": {"um_per_px": 2.3, "line_period_s": 7.648e-6, "rows_per_frame": line_periods_per_frame},
        "frame": {"shape": shape},
    }
    calibration = Calibration.parse(content).model_copy(update={"background": np.full(shape, 4.0, np.float32)})
    even = rng.poisson(4 + 100 * (spread[0] + spread[1]) @ transmission).reshape(1, *shape).astype(np.float32)
    calibration = calibration.model_copy(update={"flat": measure_flat_field(even, calibration)})
    return Truth(frames, calibration, starts[:-1] + middle * np.diff(starts, axis=0), starts, scene)


def grid_target(side: int, period_px: float, defects: float, seed: int) -> NDArray[np.float32]:
    """Lines both ways; defects are parts of the period by which they are misplaced, and of their brightness."""
    rng = np.random.default_rng(seed)
    at, lines = np.arange(side), np.full((2, side), 0.1)
    for axis in range(2):
        for k in range(int(side / period_px) + 1):
            place, light = (k + rng.normal(0, defects)) * period_px, 0.4 * rng.normal(1, 2 * defects)
            lines[axis] += light * (1 - np.tanh((np.abs(at - place) - period_px / 4) / 1.4)) / 2
    return (lines[0][:, None] + lines[1]).astype(np.float32)


def smooth_path(frames: int, speed: float, side: int, seed: int) -> NDArray[np.float64]:
    """Positions at the start of each frame (and the end of the last) on a Lissajous-like path inside the scene."""
    rng = np.random.default_rng(seed)
    phase, amplitude = rng.uniform(0, 2 * np.pi, 2), side / 4
    t = np.arange(frames + 1) * speed / amplitude
    return np.stack(
        [side / 2 + amplitude * np.sin(t + phase[0]), side / 2 + amplitude * np.sin(0.77 * t + phase[1])], 1
    )


def _sample(image: NDArray[np.float32], at: NDArray[np.float32]) -> NDArray[np.float64]:
    parts = np.array_split(at, len(at) // 30000 + 1)  # OpenCV takes no longer maps
    return np.concatenate([cv2.remap(image, p[:, 1:], p[:, :1], cv2.INTER_CUBIC)[:, 0] for p in parts]).astype(
        np.float64
    )


def _spread(place: NDArray[np.float64], shape: tuple[int, int]) -> sparse.csr_matrix:
    """Each core as a Gaussian spot on the camera's pixels, normalised so that a uniform bundle is 1 on average."""
    pixels = np.stack(np.unravel_index(np.arange(shape[0] * shape[1]), shape), 1)
    distance, core = spatial.cKDTree(place).query(pixels, k=4, distance_upper_bound=2.5)
    row = np.repeat(np.arange(len(pixels)), 4)[(near := np.isfinite(distance).ravel())]
    weight = np.exp(-0.5 * (distance.ravel()[near] / 0.5) ** 2)
    matrix = sparse.csr_matrix((weight, (row, core.ravel()[near])), shape=(len(pixels), len(place)))
    lit = matrix.sum(axis=1)
    return matrix / float(lit[lit > 0].mean())
