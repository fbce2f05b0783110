"""Disturbances of an imperfect instrument's frames from row to row, from pixel to pixel and from frame to frame."""

from __future__ import annotations

from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from napari_elsplus.simulation.rendering.sensor import GAIN_UNIT
from napari_elsplus.simulation.rendering.views import views

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.simulation.model.imperfections import Imperfections
    from napari_elsplus.simulation.model.instrument import Instrument

    Values = NDArray[np.float32]
    Rows = NDArray[np.float64]

_ROW_NOISE, _POWER, _JITTER, _PRNU, _HOT, _BENDING = range(1, 7)
"""First words of the seeds, so that no two disturbances share their random numbers."""
HOT_DN: Final = (20.0, 200.0)
"""Dark signal of a hot pixel, grey levels; chosen: visible beside, and as bright as, a lit core."""
BENT_AT_UM: Final = 500.0
"""Displacement of the probe, um, at which the bundle is bent by 76 % of what it can be; chosen: its diameter."""
_WAVES: Final = 12
"""Plane waves of which the smooth part of the bending's pattern consists; chosen."""


class Readout(NamedTuple):
    """Deviations of one frame's readout: arguments of :func:`napari_elsplus.simulation.rendering.sensor.expose`.

    ``row_power`` and ``row_black_dn`` are (rows,) float32, ``pixel_gain`` (rows, cols) uint16 in units of
    :data:`napari_elsplus.simulation.rendering.sensor.GAIN_UNIT`. Hot pixels are listed row after row: row r has those
    from ``hot_first[r]`` to ``hot_first[r + 1] - 1``, in columns ``hot_column``, with a dark signal ``hot_dn`` in grey
    levels. All are None where there are none. ``ghost`` is the share of the light in a reflection.
    """

    row_power: Values | None = None
    row_black_dn: Values | None = None
    pixel_gain: NDArray[np.uint16] | None = None
    hot_first: NDArray[np.int64] | None = None
    hot_column: NDArray[np.int64] | None = None
    hot_dn: Values | None = None
    ghost: float = 0.0


UNDISTURBED: Final = Readout()


class Fading(NamedTuple):
    """Losses of one frame's light: arguments of :func:`napari_elsplus.simulation.rendering.sampling.fade_cores`.

    ``left`` is the part of the specimen's fluorescence that is not bleached. The cores' transmission changes by the
    part ``bending`` of ``bent``, (cores,) float32, which is empty where the bundle does not bend.
    """

    left: float
    bending: float
    bent: Values


UNFADED: Final = Fading(1.0, 0.0, np.empty(0, np.float32))


class Disturbances:
    """Disturbances of the frames of one imperfect instrument; the same seed and frame give the same ones.

    Patterns of sensor and bundle belong to the instrument: their seed is the bundle's.

    Parameters
    ----------
    instrument : Instrument
        The instrument, with its imperfections.
    seed : int
        Seed of the camera's noise.
    laser : bool
        The scene is lit by the laser; otherwise by a lamp, whose power is steady.
    of_camera : bool
        False without those of rows and pixels.
    """

    def __init__(self, instrument: Instrument, seed: int, *, laser: bool, of_camera: bool) -> None:
        self._instrument, self._seed, self._laser = instrument, seed, laser
        given = instrument.imperfections
        self._has_power = laser and bool(given.power_noise_percent or given.power_ripple_percent)
        self._of_camera = of_camera and bool(
            self._has_power
            or given.row_noise_dn
            or given.prnu_percent
            or given.hot_pixels_percent
            or given.ghost_percent
        )

    @cached_property
    def _pixel_patterns(self) -> tuple[NDArray[np.uint16], NDArray[np.int64], NDArray[np.int64], Values]:
        return _pixel_patterns(self._instrument)  # to look it up there takes as long as to draw a frame's numbers

    @cached_property
    def _bending_pattern(self) -> Values:
        return _bending_pattern(self._instrument)

    @property
    def _imperfections(self) -> Imperfections:
        return self._instrument.imperfections

    def readout(self, frame_index: int) -> Readout:
        """Return the deviations of a frame's readout, by the frame's index."""
        given, rows = self._imperfections, self._instrument.frame_shape[0]
        if not self._of_camera:
            return UNDISTURBED
        black = self._rng(_ROW_NOISE, frame_index).normal(0, given.row_noise_dn, rows)
        ghost = given.ghost_percent / 100
        return Readout(self._power(frame_index), black.astype(np.float32), *self._pixel_patterns, ghost)

    def jitter_rows(self, frame_index: int) -> float:
        """Return the rows by which the laser line is lower in a frame, by the frame's index; 0 in a lamp's light."""
        sigma_rows = self._imperfections.line_jitter_rows
        if not (self._laser and sigma_rows):
            return 0.0
        return float(self._rng(_JITTER, frame_index).normal(0, sigma_rows))

    def fading(self, lit_frames: int, positions_um: Rows) -> Fading:
        """Return what bleaching and the bending of the bundle take from a frame's light.

        Parameters
        ----------
        lit_frames : int
            Number of frames for which the specimen was lit before.
        positions_um : numpy.ndarray
            (rows, 2) position of the probe while each row is read.
        """
        given = self._imperfections
        left = (1 - given.bleaching_percent / 100) ** (lit_frames / 100) if self._laser else 1.0
        if not given.bundle_bending_percent:
            return UNFADED._replace(left=left)
        moved_um = np.hypot(*positions_um[len(positions_um) // 2])
        return Fading(left, float(np.tanh(moved_um / BENT_AT_UM)), self._bending_pattern)

    def _power(self, frame_index: int) -> Values:
        """Mean power of the laser over each row's exposure, relative to its mean."""
        given, optics, rows = self._imperfections, self._instrument.optics, self._instrument.frame_shape[0]
        if not self._has_power:
            return np.ones(rows, np.float32)
        exposed_lines = max(1, round(self._instrument.slit_rows))
        by_line = self._rng(_POWER, frame_index).normal(0, 1, rows + exposed_lines - 1)
        noise = np.convolve(by_line, np.full(exposed_lines, exposed_lines**-0.5), "valid")
        exposure_s = exposed_lines * optics.line_period_s
        middles_s = frame_index * optics.frame_period_s + np.arange(rows) * optics.line_period_s - exposure_s / 2
        ripple = np.sin(2 * np.pi * given.ripple_frequency_hz * middles_s) * np.sinc(
            given.ripple_frequency_hz * exposure_s
        )
        power = 1 + (given.power_noise_percent * noise + given.power_ripple_percent * ripple) / 100
        return np.asarray(np.maximum(power, 0.0), np.float32)

    def _rng(self, kind: int, frame_index: int) -> np.random.Generator:
        return np.random.default_rng((kind, self._seed, frame_index))


@lru_cache(maxsize=2)
def _pixel_patterns(
    instrument: Instrument,
) -> tuple[NDArray[np.uint16], NDArray[np.int64], NDArray[np.int64], Values]:
    """Return the gain of each pixel, (rows, cols), and the hot pixels as fields of `Readout`."""
    given, shape = instrument.imperfections, instrument.frame_shape
    gain = _pattern_rng(instrument, _PRNU).normal(1, given.prnu_percent / 100, shape)
    rng = _pattern_rng(instrument, _HOT)
    hot = rng.random(shape, np.float32) < given.hot_pixels_percent / 100
    dark_dn = rng.uniform(*HOT_DN, shape)[hot].astype(np.float32)
    first = np.concatenate([[0], np.cumsum(hot.sum(1))])
    units = np.clip(np.round(gain / GAIN_UNIT), 0, np.iinfo(np.uint16).max).astype(np.uint16)
    return units, first.astype(np.int64), np.nonzero(hot)[1].astype(np.int64), dark_dn


@lru_cache(maxsize=2)
def _bending_pattern(instrument: Instrument) -> Values:
    """Return the relative change of each core's transmission by a bent bundle: one half by core, one half smooth."""
    (cores, *_), rng = views(instrument), _pattern_rng(instrument, _BENDING)
    places = np.stack([cores.rows_um, cores.cols_um]) / instrument.bundle.radius_um
    waves = np.cos(rng.uniform(-3, 3, (_WAVES, 2)) @ places + rng.uniform(0, 2 * np.pi, (_WAVES, 1))).sum(0)
    alone = rng.normal(size=len(waves))
    mixed = (waves - waves.mean()) / waves.std() + alone
    changes = instrument.imperfections.bundle_bending_percent / 100 * mixed / np.sqrt(2)
    return np.asarray(np.clip(changes, -0.9, None), np.float32)


def _pattern_rng(instrument: Instrument, kind: int) -> np.random.Generator:
    return np.random.default_rng((kind, instrument.bundle.seed))
