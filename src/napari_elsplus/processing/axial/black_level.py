"""Black level of a scan of depths: level of the pixels beside the views, compared with that of the background.

A zero that is wrong by a thousandth of the signal in contact moves the 10 dB distance of LS by a hundredth. Light of
the plate that is scattered to these pixels falls with depth as the views do; the black level does not.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from napari_elsplus.processing.axial.rounding import pixel_noise_dn, rounding_bias_dn
from napari_elsplus.processing.images.row_reference import dark_pixels

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import Calibration

    Curve = NDArray[np.float64]
    Frame = NDArray[np.generic]

MIN_DARK_PIXELS: Final = 1000
"""Pixels beside the views, below which the black level is unknown; chosen: fewer leave a noise of 0.02."""
_USED_PIXELS: Final = 100_000
"""Of them that are averaged; chosen: known to 0.002 grey levels of noise in each frame."""
MIN_FITTED: Final = 8
"""Frames, below which scattered light is not fitted; derived: twice the number of coefficients."""
MAX_SCATTERED: Final = 0.2
"""Light of the pixels beside the views, share of that of the views, beyond which they are not dark; chosen: twice the
scattered light of a poor instrument."""
MIN_CHANGE_SIGMAS: Final = 3.0
"""Change of the black level, standard deviations, from which it is corrected; chosen: the usual limit of detection."""
MIN_CHANGE: Final = 1e-4
"""Change of the black level, share of the largest signal, from which it is corrected; derived: it moves the 10 dB
distance by a thousandth, the least that a distance is known to."""


class DarkLevels(NamedTuple):
    """Mean level of the pixels beside the views in each frame of a scan, less that of the background.

    Parameters
    ----------
    level_dn : numpy.ndarray or None
        (T,) grey levels; None where the views leave too few such pixels.
    bias_dn : float
        Bias of the level by rounding to grey levels.
    residual_gain : float
        By which the residual signals were divided.
    background : bool
        The calibration has a background; without one, levels are those of the raw frames.
    """

    level_dn: Curve | None
    bias_dn: float
    residual_gain: float
    background: bool

    def first_after(self, earlier: DarkLevels | None) -> DarkLevels:
        """Return the levels of `earlier` frames and that of the first of these."""
        if self.level_dn is None:
            return self
        first = self.level_dn[:1]
        known = first if earlier is None or earlier.level_dn is None else np.append(earlier.level_dn, first)
        return self._replace(level_dn=known)


class BlackLevel(NamedTuple):
    """Black level that is left in the signals of a scan.

    Parameters
    ----------
    frames_dn : numpy.ndarray
        (T,) grey levels of each raw frame; zeros where they do not exceed their uncertainty.
    uncertainty_dn : float
        Standard deviation.
    background : bool
        The calibration has a background.
    known : bool
        Pixels beside the views were measured.
    """

    frames_dn: Curve
    uncertainty_dn: float
    background: bool
    known: bool

    @property
    def dn(self) -> float:
        """Mean over the frames."""
        return float(self.frames_dn.mean())


class DarkPixels:
    """Pixels beside the views of a calibration, whose mean level is measured in raw frames.

    Parameters
    ----------
    calibration : Calibration
        With its bundle section.
    shape : tuple of int
        Rows and columns of the frames.
    """

    def __init__(self, calibration: Calibration, shape: tuple[int, ...]) -> None:
        rows, cols = np.nonzero(dark_pixels(shape, calibration.measured_bundle.discs))
        step = max(1, len(rows) // _USED_PIXELS)
        self.enough = len(rows) >= MIN_DARK_PIXELS
        self._at = rows[::step], cols[::step]
        self._background = None if calibration.background is None else calibration.background[self._at]
        self._zero_dn = 0.0 if self._background is None else float(self._background.mean(dtype=np.float64))

    def level_dn(self, frame: Frame) -> float:
        """Return their mean in a raw frame (rows, cols), less that of the background."""
        return float(frame[self._at].mean(dtype=np.float64)) - self._zero_dn

    def bias_dn(self, one: Frame, other: Frame) -> float:
        """Return the bias of their mean by rounding, from one raw frame (rows, cols) and the other next to it."""
        if not np.issubdtype(one.dtype, np.integer):
            return 0.0
        noise = pixel_noise_dn(one[self._at], other[self._at])
        return rounding_bias_dn(noise, one[self._at].mean() if self._background is None else self._background)


def black_level(dark: DarkLevels, ls: Curve, residual: Curve) -> BlackLevel:
    """Estimate the black level in signals: what dark pixels keep when the light of both views is extrapolated to zero.

    Parameters
    ----------
    dark : DarkLevels
        Of the frames.
    ls, residual : numpy.ndarray
        (T,) their signals, grey levels.
    """
    if dark.level_dn is None:
        return BlackLevel(np.zeros_like(ls), 0.0, dark.background, known=False)
    views = np.stack([ls, dark.residual_gain * residual])
    level, sigma, scattered = _without_light(dark.level_dn, views)
    if scattered > MAX_SCATTERED:
        return BlackLevel(np.zeros_like(ls), 0.0, dark.background, known=False)
    ends = abs(float(level.mean())) + abs(float(np.polyfit(np.linspace(-1, 1, len(level)), level, 1)[0]))
    if dark.background and ends <= max(MIN_CHANGE_SIGMAS * sigma, MIN_CHANGE * float(ls.max())):
        return BlackLevel(np.zeros_like(ls), 0.0, background=True, known=True)
    # Alike frames are rounded alike: only where the level has changed, or is taken for a zero, does rounding count.
    return BlackLevel(level, float(np.hypot(sigma, min(dark.bias_dn, ends))), dark.background, known=True)


def _without_light(level: Curve, views: Curve) -> tuple[Curve, float, float]:
    """Return the level of each frame without light, the standard deviation, and the scattered share of the light.

    The light of the views is fitted with a drift of the level, linear over the frames. The standard deviation is the
    scatter of a frame, which contains the misfit.
    """
    if len(level) < MIN_FITTED:
        scattered = float(np.ptp(level)) / max(float(np.ptp(views.mean(axis=0))), np.finfo(float).tiny)
        return np.full_like(level, level[np.argmin(views.sum(axis=0))]), float(np.ptp(level)), scattered
    terms = np.column_stack([np.ones(len(level)), np.linspace(-1, 1, len(level)), *views])
    inverse = np.linalg.pinv(terms.T @ terms)
    factors = inverse @ (terms.T @ level)
    scattered = float(factors[2:].sum())
    # The signals of the views contain the black level, too.
    share = max(1 - scattered, 1 - MAX_SCATTERED)
    scatter = float(np.sqrt(np.square(level - terms @ factors).sum() / (len(level) - len(factors))))
    sigma = scatter * max(1.0, float(np.sqrt(max(inverse[0, 0], inverse[1, 1]))))
    return (level - factors[2:] @ views) / share, sigma / share, scattered
