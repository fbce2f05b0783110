"""Loss of a specimen's light in the course of a scan of depths, from depths that were recorded more than once.

A scan there and back, or one that returns to a reference depth, shows the same depth early and late: what the light has
lost in between is bleaching, or drift of the laser, and no sectioning.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Curve = NDArray[np.float64]

MIN_SIGNAL: Final = 0.1
"""Of the largest signal, below which frames are left out; chosen: the error of the background then counts more."""
MIN_FREEDOM: Final = 3
"""Degrees of freedom below which no loss is stated; chosen: fewer repeated frames do not show their own scatter."""
MIN_LOSS_SIGMAS: Final = 4.0
"""Standard deviations below which no loss is corrected; chosen: with three degrees of freedom 3 % exceed them."""


class LightLoss(NamedTuple):
    """Loss of light in a scan.

    Parameters
    ----------
    per_frame : float
        Rate of the exponential loss, relative, per frame.
    uncertainty : float
        One standard deviation of the rate.
    frames : int
        Frames of the scan.
    """

    per_frame: float
    uncertainty: float
    frames: int

    @property
    def significant(self) -> bool:
        """True if it stands out of the scatter of repeated frames, and is corrected."""
        return abs(self.per_frame) > MIN_LOSS_SIGMAS * self.uncertainty

    @property
    def share(self) -> float:
        """Part of the light that is lost from the first frame to the last."""
        return float(-np.expm1(-self.per_frame * (self.frames - 1)))

    @property
    def share_uncertainty(self) -> float:
        """One standard deviation of the share."""
        return float((1 - self.share) * self.uncertainty * (self.frames - 1))

    @property
    def after_scan(self) -> float:
        """Light at the beginning of a next scan over that of this one; 1 if the loss is not significant."""
        return float(np.exp(-self._corrected * self.frames))

    @property
    def error(self) -> float:
        """Error of the rate, relative, per frame: its uncertainty, or what of it exceeds that and is not corrected."""
        if self.significant:
            return self.uncertainty
        return float(np.sqrt(max(self.per_frame**2 - self.uncertainty**2, 0.0)))

    @property
    def _corrected(self) -> float:
        return self.per_frame if self.significant else 0.0

    def gains(self) -> Curve:
        """Return the factors that make up for the loss, (frames,); ones if it is not significant."""
        return np.asarray(np.exp(self._corrected * np.arange(self.frames)), np.float64)


def light_loss(depths_um: Curve, signal: Curve) -> LightLoss | None:
    """Return the loss of light in a scan; None where too few depths were recorded more than once.

    Parameters
    ----------
    depths_um : numpy.ndarray
        (T,) depth of each frame, in the order of recording.
    signal : numpy.ndarray
        (T,) grey levels, without their background.

    Examples
    --------
    >>> depths = np.r_[np.arange(0.0, 40, 4), np.arange(36.0, -1, -4)]
    >>> loss = light_loss(depths, 0.99 ** np.arange(20) / (1 + depths / 30))
    >>> round(loss.share, 3)
    0.174
    """
    depths, signal = np.asarray(depths_um, np.float64), np.asarray(signal, np.float64)
    bright = np.flatnonzero(signal > MIN_SIGNAL * signal.max(initial=0.0))
    _, place, count = np.unique(depths[bright], return_inverse=True, return_counts=True)
    again = count[place] > 1
    frame, place, level = bright[again].astype(np.float64), place[again], np.log(signal[bright[again]])
    freedom = len(frame) - len(np.unique(place)) - 1
    if freedom < MIN_FREEDOM:
        return None
    elapsed, fallen = (values - _mean_of_group(values, place) for values in (frame, level))
    spread = float(elapsed @ elapsed)
    rate = -float(elapsed @ fallen) / spread
    left = fallen + rate * elapsed
    return LightLoss(rate, float(np.sqrt(left @ left / freedom / spread)), len(depths))


def _mean_of_group(values: Curve, group: NDArray[np.intp]) -> Curve:
    """Return the mean of each value's group, (values,)."""
    total, count = np.bincount(group, values), np.bincount(group)
    return np.asarray((total / np.maximum(count, 1))[group], np.float64)
