"""Fibre bundle: positions and transmission of its cores."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from napari_elsplus.errors import InputError
from napari_elsplus.instrument.optics import BUNDLE_UM, CORE_PITCH_UM

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Bundle:
    """A fibre bundle in numbers.

    Parameters
    ----------
    diameter_um : float
        Diameter of the circle that holds the cores' centres.
    core_pitch_um : float
        Mean spacing of neighbouring cores.
    jitter : float
        Standard deviation of a core's position from the hexagonal lattice, as a share of the pitch.
    transmission_sd : float
        Standard deviation of the cores' transmission, whose mean is 1.
    core_sigma : float
        Standard deviation of a core's mode (and of its spot on the camera), as a share of the pitch.
    seed : int
        Seed of positions and transmission.

    Raises
    ------
    InputError
        If a number is impossible.
    """

    diameter_um: float = BUNDLE_UM
    core_pitch_um: float = CORE_PITCH_UM
    jitter: float = 0.08
    transmission_sd: float = 0.15
    core_sigma: float = 0.3
    seed: int = 1

    def __post_init__(self) -> None:
        for name in ("diameter_um", "core_pitch_um", "core_sigma"):
            value = getattr(self, name)
            if not (isfinite(value) and value > 0):
                raise InputError(f"the bundle's {name} is {value}", "it must be a positive number")
        if not 0 <= self.jitter <= 0.2:
            raise InputError(f"the bundle's jitter is {self.jitter}", "cores collide above 0.2 of the pitch")
        if not 0 <= self.transmission_sd <= 0.3:
            raise InputError(f"the bundle's transmission_sd is {self.transmission_sd}", "give 0 to 0.3")
        if self.diameter_um < 4 * self.core_pitch_um:
            raise InputError(
                f"a bundle of {self.diameter_um} um holds too few cores {self.core_pitch_um} um apart", "widen it"
            )

    @property
    def radius_um(self) -> float:
        """Radius of the circle that holds the cores' centres."""
        return self.diameter_um / 2

    @property
    def spot_um(self) -> float:
        """Standard deviation of a core's spot on the camera, micrometres at the bundle."""
        return self.core_sigma * self.core_pitch_um

    def cores(self) -> Cores:
        """Return the cores, ordered by row: a hexagonal lattice with jitter.

        Examples
        --------
        >>> cores = Bundle().cores()
        >>> len(cores.rows_um), bool(np.hypot(cores.rows_um, cores.cols_um).max() <= 310)
        (34023, True)
        """
        rng = np.random.default_rng(self.seed)
        reach = self.radius_um + 2 * self.core_pitch_um
        row_step = self.core_pitch_um * np.sqrt(3) / 2
        half_rows, half_cols = int(reach / row_step) + 1, int(reach / self.core_pitch_um) + 1
        i, j = np.mgrid[-half_rows : half_rows + 1, -half_cols : half_cols + 1]
        rows = i * row_step
        cols = (j + 0.5 * (i % 2)) * self.core_pitch_um
        rows = rows + rng.normal(0, self.jitter * self.core_pitch_um, rows.shape)
        cols = cols + rng.normal(0, self.jitter * self.core_pitch_um, cols.shape)
        inside = np.hypot(rows, cols) <= self.radius_um
        rows, cols = rows[inside], cols[inside]
        order = np.argsort(rows, kind="stable")
        transmission = np.clip(rng.normal(1, self.transmission_sd, len(order)), 0.1, None)
        return Cores(rows[order], cols[order], transmission / transmission.mean())


class Cores(NamedTuple):
    """The cores of a bundle: centres from the bundle's centre (um, rows down), transmission with mean 1."""

    rows_um: NDArray[np.float64]
    cols_um: NDArray[np.float64]
    transmission: NDArray[np.float64]
