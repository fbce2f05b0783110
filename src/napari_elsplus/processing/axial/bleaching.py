"""Loss of a specimen's light in the course of a scan of depths, from depths that were recorded more than once.

A scan there and back, or one that returns to a reference depth, shows the same depth early and late: what the light has
lost in between is bleaching, or drift of the laser, and no sectioning. Both dim LS and ELS+ alike. A plate whose
distance differs between frames of one depth, by backlash of the stage or drift of the focus, dims ELS+ otherwise than
LS, by which it is noticed.
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
MIN_BY_LIGHT: Final = 2.0
"""Loss over what the plate's distance explains of it, below which it is not corrected; chosen: most of it is light."""
SLOW_CYCLES: Final = (1.0, 1.5, 2.0, 3.0)
"""In a scan, of light that varies slowly, alike before and after its turn; chosen: faster beats are told."""
MIN_SLOW_SIGMAS: Final = 3.0
"""Standard deviations by which successive frames vary alike where light does so slowly; chosen."""
MIN_LOSS_SIGMAS: Final = 4.0
"""Standard deviations below which no loss is corrected; chosen: with three degrees of freedom 3 % exceed them."""


class LightLoss(NamedTuple):
    """Loss of light in a scan.

    Parameters
    ----------
    per_frame : float
        Rate of the exponential loss of LS, relative, per frame.
    scatter : float
        One standard deviation of the rate by the scatter of repeated frames.
    frames : int
        Frames of the scan.
    law_sigma : float
        One standard deviation of the law by which the light falls: 0 is an exponential, 1 by as much in every frame.
    by_distance : float
        Part of the rate that a plate whose distance differs between frames of one depth explains, magnitude.
    slow : float
        Standard deviation, relative, of light that varies slowly about that loss; 0 if frames of one depth show none.
    """

    per_frame: float
    scatter: float
    frames: int
    law_sigma: float = 0.0
    by_distance: float = 0.0
    slow: float = 0.0

    @property
    def uncertainty(self) -> float:
        """One standard deviation of the rate."""
        return float(np.hypot(self.scatter, self.by_distance))

    @property
    def significant(self) -> bool:
        """True if it stands out of the scatter of repeated frames, is light for the most part, and is corrected."""
        return abs(self.per_frame) > max(MIN_LOSS_SIGMAS * self.scatter, MIN_BY_LIGHT * self.by_distance)

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
        """Error of the rate, relative, per frame: its uncertainty; the excess over scatter of one not corrected."""
        if self.significant:
            return self.uncertainty
        return float(np.sqrt(max(self.per_frame**2 - self.scatter**2, 0.0)))

    @property
    def _corrected(self) -> float:
        return self.per_frame if self.significant else 0.0

    def gains(self, sigmas: float = 0.0) -> Curve:
        """Return the factors that make up for the loss, (frames,); ones if it is not significant.

        Parameters
        ----------
        sigmas : float
            Standard deviations by which the law departs from an exponential, towards the same in every frame.
        """
        falls = self._corrected * np.arange(self.frames, dtype=np.float64)
        return np.asarray(np.exp(falls - sigmas * self.law_sigma * _bend(falls)), np.float64)

    def slow_errors(self) -> list[Curve]:
        """Return the factors (frames,) by which light that varies slowly may err, one standard deviation each.

        Frames of one depth show what differs before and after the turn of a scan there and back, which their mean takes
        out. What is alike before and after it is as much on average, and hidden.
        """
        from_turn = 2 * np.pi * np.linspace(-0.5, 0.5, self.frames)
        amplitude = self.slow * np.sqrt(2 / len(SLOW_CYCLES))
        return [np.exp(amplitude * np.cos(cycles * from_turn)) for cycles in SLOW_CYCLES if self.slow]


def light_loss(depths_um: Curve, ls: Curve, els: Curve) -> LightLoss | None:
    """Return the loss of light in a scan; None where too few depths were recorded more than once.

    Parameters
    ----------
    depths_um : numpy.ndarray
        (T,) depth of each frame, in the order of recording.
    ls, els : numpy.ndarray
        (T,) signals in grey levels, without their background.

    Examples
    --------
    >>> depths = np.r_[np.arange(0.0, 40, 4), np.arange(36.0, -1, -4)]
    >>> ls, els = 1 / (1 + depths / 60), 1 / (1 + (depths / 30) ** 2)
    >>> light = 0.99 ** np.arange(20)
    >>> loss = light_loss(depths, light * ls, light * els)
    >>> round(loss.share, 3), round(loss.by_distance, 6)
    (0.174, 0.0)
    """
    depths, ls, els = (np.asarray(values, np.float64) for values in (depths_um, ls, els))
    bright = np.flatnonzero(ls > MIN_SIGNAL * ls.max(initial=0.0))
    level = np.log(ls[bright])
    of_ls = _rate(depths, level, bright)
    if of_ls is None:
        return None
    rate, scatter, slow = of_ls
    loss = LightLoss(rate, scatter, len(depths), _law_sigma(rate, depths, level, bright), slow=slow)
    both = np.flatnonzero((ls > MIN_SIGNAL * ls.max()) & (els > MIN_SIGNAL * els.max()))
    kept = np.log(els[both] / ls[both])
    of_kept = _rate(depths, kept, both)
    if of_kept is None:
        return loss
    # By how much LS falls with depth where the share kept falls by a given part: the same for a displaced plate.
    fall = kept - kept.mean()
    ls_per_kept = float(fall @ np.log(ls[both]) / max(fall @ fall, np.finfo(float).tiny))
    beyond_scatter = float(np.sqrt(max(of_kept[0] ** 2 - of_kept[1] ** 2, 0.0)))
    return loss._replace(by_distance=abs(ls_per_kept) * beyond_scatter)


def _bend(falls: Curve) -> Curve:
    """Return how much brighter frames (T,) are where each takes as much light than where it falls as an exponential.

    Both as logarithms; `falls` is by how much it has fallen as an exponential, and both fall by as much in all.
    """
    return np.asarray(falls + np.log1p(np.expm1(-falls[-1]) * np.linspace(0, 1, len(falls))), np.float64)


def _law_sigma(rate: float, depths: Curve, level: Curve, frames: NDArray[np.intp]) -> float:
    """Return the standard deviation of the law by which the logarithm of LS falls, which is 1 beforehand.

    A scan there and back shows how light falls up to what is alike before and after its turn, thus nothing of the law.
    """
    _, place = np.unique(depths[frames], return_inverse=True)
    time = np.linspace(-1, 1, len(depths))
    terms = np.stack([time, time**3, _bend(rate * np.arange(len(depths), dtype=np.float64))], axis=1)[frames]
    *odd, bent, fallen = (_from_mean_of_group(each, place) for each in (*terms.T, level))
    turned = np.stack(odd, axis=1)
    seen, left = (each - turned @ np.linalg.lstsq(turned, each, rcond=None)[0] for each in (bent, fallen))
    noise = max(float(left @ left), np.finfo(float).tiny) / max(len(frames) - int(place.max()) - 3, 1)
    return float((1 + seen @ seen / noise) ** -0.5)


def _rate(depths: Curve, level: Curve, frames: NDArray[np.intp]) -> tuple[float, float, float] | None:
    """Return the rate at which a logarithm falls per frame at the same depth, with its standard deviation by scatter.

    Third, the standard deviation of what successive frames have in common beyond that. None of too few frames that
    repeat a depth.
    """
    _, place, count = np.unique(depths[frames], return_inverse=True, return_counts=True)
    again = count[place] > 1
    frame, place, level = frames[again].astype(np.float64), place[again], level[again]
    freedom = len(frame) - len(np.unique(place)) - 1
    if freedom < MIN_FREEDOM:
        return None
    elapsed, fallen = (_from_mean_of_group(values, place) for values in (frame, level))
    spread = float(elapsed @ elapsed)
    rate = -float(elapsed @ fallen) / spread
    left = fallen + rate * elapsed
    square = float(left @ left)
    shared = float(left[1:] @ left[:-1])  # of noise that is not shared 0 on average; each pair is there twice
    slow = np.sqrt(shared / len(left)) if shared > MIN_SLOW_SIGMAS * square * np.sqrt(2 / len(left)) else 0.0
    return rate, float(np.sqrt(square / freedom / spread)), float(slow)


def _from_mean_of_group(values: Curve, group: NDArray[np.intp]) -> Curve:
    """Return how far each value is from the mean of its group, (values,)."""
    total, count = np.bincount(group, values), np.bincount(group)
    return np.asarray(values - (total / np.maximum(count, 1))[group], np.float64)
