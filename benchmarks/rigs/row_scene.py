"""Scenes of the row-by-row rig: a focal plane, out-of-focus planes, and the probe's motion over them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import cv2
import numpy as np
from scipy import ndimage

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    Floats = NDArray[np.float64]
    Image = NDArray[np.float32]

SIDE: Final = 1400
"""Rows and columns of a scene, px of the confocal view."""
SWEEP_PX: Final = 290.0
"""Amplitude of the probe's path to either side; chosen: it stays within the scene."""
SWING_DEG: Final = 20.0
"""Amplitude of the probe's rotation to either side; chosen, that of a wrist."""


def nuclei(random: np.random.Generator) -> Image:
    """Return ellipses of 2 to 5 px and unequal brightness, (SIDE, SIDE)."""
    image = np.zeros((SIDE, SIDE), np.float32)
    for _ in range(SIDE**2 // 450):
        centre, axes = random.uniform(0, SIDE, 2), random.uniform(2.2, 4.5, 2)
        shape = [tuple(int(value) for value in 16 * pair) for pair in (centre, axes)]
        cv2.ellipse(image, *shape, random.uniform(0, 180), 0, 360, random.uniform(0.4, 1), -1, cv2.LINE_8, 4)
    return image


def fibres(random: np.random.Generator) -> Image:
    """Return curved strands 3 to 7 px wide, of uneven brightness along each, (SIDE, SIDE)."""
    image = np.zeros((SIDE, SIDE), np.float32)
    t = np.linspace(-1, 1, 160)
    for _ in range(SIDE**2 // 9000):
        a, along, across = random.uniform(0, np.pi), t * random.uniform(150, 500), random.normal(0, 120) * t**2
        strand = np.c_[along * np.cos(a) - across * np.sin(a), along * np.sin(a) + across * np.cos(a)]
        points = np.array(16 * (strand + random.uniform(0, SIDE, 2)), np.int32)
        width = int(random.integers(3, 8))
        cv2.polylines(image, [points], False, random.uniform(0.4, 0.9), width, cv2.LINE_8, 4)
    return np.asarray(image * (0.9 + 1.2 * ndimage.gaussian_filter(random.normal(size=image.shape), 1.5)), np.float32)


def vessels(random: np.random.Generator) -> Image:
    """Return a network of bright walls 8 px wide along the zero crossings of a random field, (SIDE, SIDE)."""
    field = ndimage.gaussian_filter(random.normal(size=(SIDE, SIDE)), 18)
    away = np.abs(field) / (np.hypot(*np.gradient(field)) + 1e-9)
    bright = 0.55 + 8 * ndimage.gaussian_filter(random.normal(size=(SIDE, SIDE)), 6)
    return np.asarray((away < 4) * bright, np.float32)


SCENES: Final = {"nuclei": nuclei, "fibres": fibres, "vessels": vessels}


class Scene:
    """A focal plane, out-of-focus planes of mottle, and the path of the probe.

    Parameters
    ----------
    kind : str
        One of :data:`SCENES`.
    motion : str
        "smooth", "jerk" (jumps of 25 px) or "still".
    step, turn_deg : float
        Speed, px per frame, and largest rotation, degrees per frame: to and fro by 20 degrees.
    planes : int
        Number of out-of-focus planes.
    random : numpy.random.Generator
    """

    def __init__(
        self, kind: str, motion: str, step: float, turn_deg: float, planes: int, random: np.random.Generator
    ) -> None:
        self.motion, self.step, self.turn_deg = motion, step, turn_deg
        self.texture: Image = np.clip(cv2.GaussianBlur(SCENES[kind](random), (0, 0), 1.0), 0, 1)
        self._spline = ndimage.spline_filter(self.texture.astype(float), 3)
        mottle = [ndimage.gaussian_filter(random.normal(size=(SIDE, SIDE)), 25) for _ in range(planes)]
        self._deep = [np.exp(0.7 * field / field.std()) / 1.3 for field in mottle]
        self._phase, self._centre = random.uniform(0, 2 * np.pi, 4), random.uniform(660, 740, 2)

    def place(self, time: ArrayLike) -> Floats:
        """Return the scene's point (row, col) under the bundle's centre at times in frames, (2, ...)."""
        t = np.asarray(time, float)
        moved = np.zeros((2, *t.shape))
        if self.motion != "still":
            w, phase = self.step / SWEEP_PX / 1.15, self._phase
            moved[:] = SWEEP_PX * np.sin(w * t + phase[0]), SWEEP_PX * np.sin(1.31 * w * t + phase[1])
            moved += 12 * np.sin([0.31 * t + phase[2], 0.31 * t + phase[3]])
        if self.motion == "jerk":
            for k in np.arange(12.3, 300, 17):
                jump = 25 * (1 + np.tanh((t - k) / 0.3))
                moved += np.array([np.cos(k) * jump, np.cos(2 * k) * jump])
        return np.asarray(moved + self._centre.reshape(2, *[1] * t.ndim))

    def angle(self, time: Floats) -> Floats:
        """Return the probe's rotation at times in frames, radians."""
        swing = np.deg2rad(SWING_DEG)
        return np.asarray(swing * np.sin(self.turn_deg / SWING_DEG * time))

    def _at(self, y: Floats, x: Floats, time: Floats) -> Floats:
        a, (row, col) = self.angle(time), self.place(time)
        return np.array([np.cos(a) * y - np.sin(a) * x + row, np.sin(a) * y + np.cos(a) * x + col])

    def focal(self, y: Floats, x: Floats, time: Floats) -> Floats:
        """Return the focal plane at points of the bundle, each at its own time."""
        light = ndimage.map_coordinates(self._spline, self._at(y, x, time), order=3, prefilter=False, mode="nearest")
        return np.asarray(np.clip(light, 0, None))

    def deep(self, plane: int, y: Floats, x: Floats, time: Floats) -> Floats:
        """Return an out-of-focus plane at points of the bundle, each at its own time."""
        return np.asarray(ndimage.map_coordinates(self._deep[plane], self._at(y, x, time), order=1, mode="nearest"))
